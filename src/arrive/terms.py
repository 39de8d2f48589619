"""The observation terms by name, with unit, frame and meaning. Used by training, export, controller and documentation.

`arrive.task.observations` computes the terms in training, and defines scale, noise and reflection.
`arrive.deployment.terms` computes them in the controller, without torch.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from arrive.registry import add


@dataclass(frozen=True)
class TermMeaning:
    """Unit, frame and meaning of a term's entries."""

    unit: str
    frame: str
    meaning: str


TERMS: dict[str, TermMeaning] = {
    "base_lin_vel": TermMeaning("m/s", "base", "velocity of the base frame's origin"),
    "base_ang_vel": TermMeaning("rad/s", "base", "angular velocity of the base"),
    "gravity": TermMeaning("1", "base", "direction of gravity, (0, 0, -1) when upright"),
    "target": TermMeaning("m", "base", "vector from the base to the target"),
    "time_left": TermMeaning("s", "", "time left to reach the target, at most one episode"),
    "speed_command": TermMeaning("m/s", "base", "commanded forward speed"),
    "yaw_rate_command": TermMeaning("rad/s", "base", "commanded yaw rate"),
    "joint_pos": TermMeaning("rad", "relative to the default pose", "joint positions minus the default pose"),
    "joint_vel": TermMeaning("rad/s", "joint", "joint velocities"),
    "action": TermMeaning(
        "action scale", "joint", "the network's last output; after a safe stance, the pose that was held"
    ),
    "foot_heights": TermMeaning(
        "m", "heading", "as heights, at the grid's points nearest to a small grid around each foot"
    ),
    "heights": TermMeaning("m", "heading", "clip(base z - offset - ground, *clip) at the grid's points"),
}
"""In the order of training."""


def register_term(name: str, meaning: TermMeaning) -> None:
    """Add your own observation term; see docs/extend.md.

    Raises:
        ArriveError: the name is taken.
    """
    add("observation", TERMS, name, meaning)


LABEL_ROUNDING_M = 0.0501
"""Tolerance for labels of grid points in older files, which have one decimal place."""
ROUNDED_POINT = re.compile(r"\((-?\d+\.\d), (-?\d+\.\d)\)")
"""Label of a grid point in an older file."""


def same_labels(saved: Any, present: Sequence[str]) -> bool:
    """Whether the labels of a term in a file mean the same entries as those of this version."""
    if not isinstance(saved, Sequence) or len(saved) != len(present):
        return False
    return all(same_label(one, other) for one, other in zip(saved, present, strict=True))


def same_label(saved: Any, present: str) -> bool:
    """Whether a label in a file means the same entry. In older files the labels of grid points are rounded to 0.1 m."""
    if saved == present:
        return True
    point = ROUNDED_POINT.fullmatch(saved) if isinstance(saved, str) else None
    if point is None or not present.startswith("("):
        return False
    pairs = zip(point.groups(), present.strip("()").split(","), strict=True)
    return all(abs(float(rounded) - float(exact)) <= LABEL_ROUNDING_M for rounded, exact in pairs)


class Timed(Protocol):
    """A task with a reward window: its configuration in training, or its description in an exported file."""

    @property
    def reward_window_s(self) -> float: ...

    @property
    def episode_s(self) -> float: ...


LEAD_M = 3.0
"""Distance of the target of the pseudo velocity control: it stays so far ahead of the robot (paper, section Energy
Consumption) [m]."""


def hold_time(task: Timed) -> float:
    """The `time_left` given to a policy that waits at its target: the reward window, at most half an episode [s]."""
    return min(task.reward_window_s, 0.5 * task.episode_s)
