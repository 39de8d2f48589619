"""What a policy can do: its training terrain, and the hardest value that it solves according to its measurement."""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from arrive import policies
from arrive.config import Config, saved_config
from arrive.deployment.opening import open_policy
from arrive.deployment.policy_file import PolicyFile
from arrive.errors import ArriveError
from arrive.files import read_json
from arrive.policies import CONFIG_NAME, DEFAULT, EXPORTED, POLICY_NAME, find_policy, shipped_names
from arrive.policies.solved import TELLING, amounts, solved_beside, solved_in
from arrive.terrain import FAMILIES, Layout
from arrive.terrain.ground import Ground


@dataclass(frozen=True)
class Skill:
    """A policy with its name and the values that it solves according to its measurement."""

    name: str
    policy: PolicyFile
    solved: dict[str, float]
    """The hardest value with a success rate of 95 %, by terrain family."""

    @cached_property
    def config(self) -> Config:
        """The configuration it was trained with.

        Raises:
            ArriveError: it was written by another version.
        """
        return saved_config(self.policy.meta["training"]["config"], self.policy.path)

    @property
    def samples(self) -> int:
        """Policy steps it was trained for."""
        return int(self.policy.meta["training"]["samples"])

    @property
    def levels(self) -> int:
        """Number of terrain levels in its training."""
        return self.config.terrain.levels

    def value(self, family: str) -> float:
        """The family's hardest solved value; the value of a middle level if none is known."""
        kind = FAMILIES[family]
        return self.solved.get(family, kind.value(self.levels // 2, self.levels))

    def ground(self, layout: Layout) -> Ground:
        """The terrain to start with: of the families in its training, the most interesting one that it solves."""
        trained = [name for name in self.config.terrain.families if name in FAMILIES]
        telling = [name for name in TELLING if name in (self.solved or trained) and name in trained]
        # Without a measurement, flat ground is safer than a middle level.
        family = "flat" if not telling or (not self.solved and "flat" in trained) else telling[0]
        return Ground(FAMILIES[family], self.value(family), layout)


def open_skill(name: str | None) -> Skill:
    """Read a policy and its measurement; see `open_policy`."""
    name = name or DEFAULT
    policy, path = open_policy(name), find_policy(name)
    # An exported file may have been measured since.
    beside = solved_beside(path) if path.suffix == EXPORTED else {}
    return Skill(name, policy, beside or solved_in(policy.meta.get("evaluation")))


@dataclass(frozen=True)
class Choice:
    """A policy in the menu."""

    name: str
    robot: str
    """Name of its robot."""
    label: str
    """Text in the menu of policies: the short name and the solved values."""


def choices(current: Skill) -> tuple[Choice, ...]:
    """The policies in the menu: the shipped ones with a readable configuration, and the current one.

    Each is there once, also if the current one is a shipped one that was named by its path, and no two have the same
    label.
    """
    own = _file_of(find_policy(current.name))
    shipped = {
        name: robot
        for name in shipped_names()
        if _file_of(policies.SHIPPED / name) != own and (robot := _robot_of(policies.SHIPPED / name))
    }
    robots = shipped | {current.name: current.config.robot}
    labels = {name: _label(name, current.solved if name == current.name else None) for name in robots}
    often = Counter(labels.values())
    return tuple(
        Choice(name, robot, labels[name] if often[labels[name]] == 1 else f"{labels[name]} ({name})")
        for name, robot in sorted(robots.items())
    )


def _file_of(path: Path) -> Path:
    """The file of a policy that is named by it or by its folder."""
    return (path / POLICY_NAME if path.is_dir() else path).resolve()


def _robot_of(run: Path) -> str | None:
    try:
        return str(read_json(run / CONFIG_NAME)["config"]["robot"])
    except (ArriveError, KeyError, TypeError):
        return None


def _label(name: str, known: dict[str, float] | None) -> str:
    """The label of a policy.

    Args:
        known: the values that it solves, if they were read already.
    """
    short = Path(name).name
    try:
        solved = amounts(solved_beside(find_policy(name)) if known is None else known)
    except ArriveError:  # the policy itself can still be played
        return f"{short}: measurement damaged"
    if not solved:
        return short
    others = f" and {len(solved) - 1} more" if len(solved) > 1 else ""
    return f"{short}: {solved[0]}{others}"
