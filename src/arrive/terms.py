"""The observation's terms by name: what each is, for training, the exported file, the controller and the documents.

How training computes a term is in `arrive.task.observations`, with its scale, noise and mirror maps; how the controller
does, on a computer without torch, in `arrive.deployment.terms`.
"""

from dataclasses import dataclass
from typing import Protocol

from arrive.registry import add


@dataclass(frozen=True)
class TermMeaning:
    """What the entries of one term are."""

    unit: str
    frame: str
    meaning: str


TERMS: dict[str, TermMeaning] = {
    "base_lin_vel": TermMeaning("m/s", "base", "velocity of the base frame's origin"),
    "base_ang_vel": TermMeaning("rad/s", "base", "angular velocity of the base"),
    "gravity": TermMeaning("1", "base", "direction of gravity, (0, 0, -1) when upright"),
    "target": TermMeaning("m", "base", "from the base to the target"),
    "time_left": TermMeaning("s", "", "until the robot is to be there, at most an episode"),
    "speed_command": TermMeaning("m/s", "base", "forward speed to follow"),
    "yaw_rate_command": TermMeaning("rad/s", "base", "yaw rate to follow"),
    "joint_pos": TermMeaning("rad", "relative to the default pose", "joint positions minus the default pose"),
    "joint_vel": TermMeaning("rad/s", "joint", "joint velocities"),
    "action": TermMeaning(
        "action scale", "joint", "the network's last output; after a safe stance the pose that was held"
    ),
    "heights": TermMeaning("m", "heading", "clip(base z - offset - ground, *clip) at the grid's points"),
}
"""In the order of training."""


def register_term(name: str, meaning: TermMeaning) -> None:
    """Add an observation of one's own; see docs/extend.md.

    Raises:
        ArriveError: the name is taken.
    """
    add("observation", TERMS, name, meaning)


class Timed(Protocol):
    """A task with a reward window: its configuration in training, or what an exported file says of it."""

    reward_window_s: float
    episode_s: float


def hold_time(task: Timed) -> float:
    """The `time_left` that a policy waiting at its target is told: the reward window, half an episode at most [s]."""
    return min(task.reward_window_s, 0.5 * task.episode_s)
