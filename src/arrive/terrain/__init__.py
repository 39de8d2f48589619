"""The terrain families. A new one needs one module and one line in `FAMILIES`."""

import numpy as np

from arrive.errors import ArriveError
from arrive.registry import add, get
from arrive.terrain.build import build_tile
from arrive.terrain.family import Family, Layout
from arrive.terrain.flat import FLAT
from arrive.terrain.gap import GAP
from arrive.terrain.obstacles import OBSTACLES
from arrive.terrain.pit import PIT
from arrive.terrain.rough import ROUGH
from arrive.terrain.slope import SLOPE, SLOPE_DOWN
from arrive.terrain.stairs import STAIRS, STAIRS_DOWN
from arrive.terrain.steps import STEPS
from arrive.terrain.tile import Tile

FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        FLAT,
        ROUGH,
        SLOPE,
        SLOPE_DOWN,
        STAIRS,
        STAIRS_DOWN,
        STEPS,
        OBSTACLES,
        GAP,
        PIT,
    )
}

__all__ = ["FAMILIES", "Family", "Layout", "Tile", "build_tile", "get_family", "parse_families", "register_terrain"]


def register_terrain(family: Family) -> None:
    """Add your own terrain family, so that commands accept its name; see docs/extend.md.

    Raises:
        ArriveError: the name is taken, or one of its tiles fails the checks of `build_tile`.
    """
    for layout in ("training", "evaluation"):
        for value in {family.lowest, family.highest}:
            build_tile(family, value, np.random.default_rng(0), layout)
    add("terrain", FAMILIES, family.name, family)


def get_family(name: str) -> Family:
    """The family of this name. An unknown name raises an error that lists the valid ones."""
    return get("terrain", FAMILIES, name)


def parse_families(names: str) -> tuple[Family, ...]:
    """The families of a comma-separated list such as "pit,gap", or all of them for "all"."""
    if names.strip() == "all":
        return tuple(FAMILIES.values())
    listed = [name.strip() for name in names.split(",")]
    if not all(listed):
        raise ArriveError(f"empty terrain name in {names!r}; write for example 'pit,gap', or 'all'")
    repeated = sorted({name for name in listed if listed.count(name) > 1})
    if repeated:
        raise ArriveError(f"terrain {', '.join(repeated)} is listed more than once in {names!r}")
    return tuple(get_family(name) for name in listed)
