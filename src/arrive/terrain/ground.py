"""The ground of a single simulated robot: a terrain family at one value of its parameter."""

import math
from dataclasses import dataclass

import numpy as np

from arrive.errors import ArriveError
from arrive.terrain import Family, Layout, Tile, build_tile, get_family


@dataclass(frozen=True)
class Ground:
    """A terrain family at one value of its parameter."""

    family: Family
    value: float
    """In the family's unit."""
    layout: Layout = "training"

    @property
    def amount(self) -> str:
        """The value with its unit, empty for a family without a parameter."""
        return f"{self.value:.3g} {self.family.unit}".strip() if varies(self.family) else ""

    @property
    def words(self) -> str:
        """The ground in words, such as "a gap to leap over, width 0.4 m"."""
        family = self.family
        return f"{family.description}, {family.parameter} {self.amount}" if self.amount else family.description

    def build(self, seed: int = 1, size: float = 1.0) -> Tile:
        """The tile for a robot of this size. `seed` is used by families with random terrain."""
        return build_tile(self.family, self.value, np.random.default_rng(seed), self.layout, size)


def varies(family: Family) -> bool:
    """Whether a family has a parameter."""
    return family.lowest != family.highest


def ground_of(terrain: str, level: int | None = None, levels: int = 10, layout: Layout = "training") -> Ground:
    """The ground named on the command line.

    Args:
        terrain: a family's name, or NAME=VALUE with the value in the family's unit.
        level: one of the policy's own levels, as in `arrive eval`. Without a level or a value, level 0.
        levels: number of levels the policy was trained with.

    Raises:
        ArriveError: no such family or level, a value outside the family's range, or both a level and a value.
    """
    name, sign, text = terrain.partition("=")
    family = get_family(name.strip())
    if not sign:
        return Ground(family, family.value(level or 0, levels), layout)
    if level is not None:
        raise ArriveError(f"give a level or a value, not both: --level {level}, --terrain {terrain}")
    return Ground(family, checked_value(family, text), layout)


def checked_value(family: Family, text: str | float) -> float:
    """A value of a family's parameter.

    Raises:
        ArriveError: not a number, or outside the family's range.
    """
    if not varies(family):
        raise ArriveError(f"{family.name} has no parameter: write --terrain {family.name}")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    # 1 % tolerance, so that a value that was printed rounded can be typed in again.
    slack = 0.01 * (family.highest - family.lowest)
    if not family.lowest - slack <= value <= family.highest + slack:
        raise ArriveError(
            f"the {family.parameter} of {family.name} is {family.lowest:g} to {family.highest:g} {family.unit}, "
            f"not {text}; write for example --terrain {family.name}={family.lowest:g}"
        )
    return min(max(value, family.lowest), family.highest)
