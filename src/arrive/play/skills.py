"""What a policy can do: the terrain it was trained on, and the hardest of it that it was measured to solve."""

import json
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from arrive.config import Config, saved_config
from arrive.deployment.opening import open_policy
from arrive.deployment.policy_file import PolicyFile
from arrive.policies import DEFAULT, SHIPPED, find_run, trained_names
from arrive.terrain import FAMILIES, Layout
from arrive.terrain.ground import Ground, varies

MEASURED = "difficulty.json"
"""Result of `arrive eval --protocol difficulty` in a run folder."""
SOLVED = "max_at_95"
"""Its entry for the hardest value that is solved in 95 % of the episodes."""
TELLING = ("gap", "pit", "stairs", "obstacles", "steps", "slope", "stairs_down", "slope_down", "rough")
"""A policy that was trained on several of these opens on the first that it solves."""


@dataclass(frozen=True)
class Skill:
    """A policy by its name, with what it was measured to solve."""

    name: str
    policy: PolicyFile
    solved: dict[str, float]
    """By family: the hardest value that is solved at 95 %."""

    @cached_property
    def config(self) -> Config:
        """The configuration it was trained with.

        Raises:
            ArriveError: it is one of another version.
        """
        return saved_config(self.policy.meta["training"]["config"], self.policy.path)

    @property
    def levels(self) -> int:
        """Number of its own levels."""
        return self.config.terrain.levels

    def value(self, family: str) -> float:
        """The family's hardest solved value, or that of a middle level where none is known."""
        kind = FAMILIES[family]
        return self.solved.get(family, kind.value(self.levels // 2, self.levels))

    def ground(self, layout: Layout) -> Ground:
        """The terrain that shows it: of those it was trained on, the most telling one that it solves."""
        trained = [name for name in self.config.terrain.families if name in FAMILIES]
        telling = [name for name in TELLING if name in (self.solved or trained) and name in trained]
        # Of a policy that nobody measured, level ground shows more than a middle level of everything.
        family = "flat" if not telling or (not self.solved and "flat" in trained) else telling[0]
        return Ground(FAMILIES[family], self.value(family), layout)


def open_skill(name: str | None) -> Skill:
    """Read a policy and what is known of it; see `open_policy`."""
    name = name or DEFAULT
    policy = open_policy(name)
    return Skill(name, policy, solved_in(policy.meta.get("evaluation")))


def solved_in(measurement: Any) -> dict[str, float]:
    """Hardest value solved at 95 % by family, from the content of a measurement; empty where it is none."""
    try:
        entries = {name: entry.get(SOLVED) for name, entry in measurement["families"].items() if name in FAMILIES}
    except (KeyError, AttributeError, TypeError):
        return {}
    return {family: float(value) for family, value in entries.items() if _within(family, value)}


def solved_beside(run: Path) -> dict[str, float]:
    """The same of a run folder, without reading its policy."""
    try:
        return solved_in(json.loads((run / MEASURED).read_text()))
    except (OSError, ValueError):
        return {}


def _within(family: str, value: object) -> bool:
    """Whether a file's value is one of the family's parameter."""
    kind = FAMILIES[family]
    return isinstance(value, int | float) and math.isfinite(value) and kind.lowest <= value <= kind.highest


def choices(current: str) -> dict[str, str]:
    """Names of the policies at hand by what a chooser shows, the current one among them."""
    names = sorted({*SHIPPED, *trained_names(), current})
    return {_label(name): name for name in names}


def _label(name: str) -> str:
    solved = {} if name in SHIPPED else solved_beside(find_run(Path(name)))
    solved = {family: value for family, value in solved.items() if varies(FAMILIES[family])}
    short = Path(name).name if name not in SHIPPED else name
    if not solved:
        return short
    first, *others = sorted(solved, key=lambda family: (*TELLING, family).index(family))
    amount = Ground(FAMILIES[first], solved[first]).amount
    return f"{short}: {first} {amount}" + (f" and {len(others)} more" if others else "")
