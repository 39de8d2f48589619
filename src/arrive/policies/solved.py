"""The hardest terrain that policies solve, read from the result of `arrive eval --protocol difficulty`."""

from pathlib import Path
from typing import Any

from arrive.policies import DIFFICULTY_NAME, EXPORTED, results_folder
from arrive.results.read import read_if_there
from arrive.terrain import FAMILIES
from arrive.terrain.ground import Ground, varies

SOLVED = "max_at_95"
"""Key of the hardest value that is solved, with every easier one, in 95 % of the episodes."""
TELLING = ("gap", "pit", "stairs", "obstacles", "steps", "slope", "stairs_down", "slope_down", "rough")
"""Terrains in the order in which a policy's skills are listed."""


def solved_in(measurement: Any) -> dict[str, float]:
    """Hardest value solved at 95 %, by family. Empty if the content is not a measurement."""
    try:
        entries = {name: entry.get(SOLVED) for name, entry in measurement["families"].items() if name in FAMILIES}
    except (KeyError, AttributeError, TypeError):
        return {}
    return {family: float(value) for family, value in entries.items() if _within(family, value)}


def solved_beside(path: Path) -> dict[str, float]:
    """The same for a run folder or a file in it, or an exported file with the results of measuring it beside it.

    Empty if it was not measured. The policy is not read.

    Raises:
        ArriveError: its measurement is damaged.
    """
    run = path if path.is_dir() else results_folder(path) if path.suffix == EXPORTED else path.parent
    measured = read_if_there(run / DIFFICULTY_NAME, "difficulty")
    return {} if measured is None else solved_in(measured)


def _within(family: str, value: object) -> bool:
    """Whether a file's value is one of the family's parameter."""
    kind = FAMILIES[family]
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return kind.lowest <= value <= kind.highest  # false for NaN


def amounts(solved: dict[str, float]) -> list[str]:
    """Solved values as text, such as "gap 0.4 m", in the order of `TELLING`, without terrains that have no value."""
    varying = [family for family in solved if varies(FAMILIES[family])]
    varying.sort(key=lambda family: (*TELLING, family).index(family))
    return [f"{family} {Ground(FAMILIES[family], solved[family]).amount}" for family in varying]
