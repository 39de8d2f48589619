"""The interface between environment and tasks. Each task implements it in one module."""

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

import torch
from torch import Tensor

from arrive.errors import ArriveError
from arrive.robots.robot import Robot
from arrive.task.observations import ObservationConfig, ObservationTerm
from arrive.task.state import State
from arrive.terrain.rasters import Rasters


@dataclass(frozen=True)
class TaskConfig:
    """The fields of every task's configuration. Each task adds its own fields and its reward table."""

    kinds: ClassVar[dict[str, "type[TaskConfig]"]] = {}
    """Configuration classes by task name. `Config.task` is an instance of one of them."""

    name: str = ""
    """The task, see `arrive list tasks`."""
    episode_s: float = 6.0
    """Longest episode [s]."""
    rewards: Any = None
    """The reward terms with their weights and parameters."""

    def measured(self) -> Self:
        """The same for a measurement: every episode has full length and a single command."""
        return self


@dataclass(frozen=True)
class Start:
    """Where robots start an episode, and on which tiles."""

    env_ids: Tensor
    """(n,) environments."""
    base_pos_w: Tensor
    """(n, 3) [m]."""
    tile_ids: Tensor
    """(n,) rasters of their tiles."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of episodes, as if they ended now; each (n,) bool."""

    success: Tensor
    promote: Tensor
    """The terrain level goes up."""
    demote: Tensor
    """The terrain level goes down."""
    failures: dict[str, Tensor]
    """By cause. Every episode without success has exactly one."""
    remaining: Tensor
    """(n,) float: the distance left, to the target or to the commanded distance [m]."""

    def check(self, count: int) -> None:
        """Refuse masks that are not one bool for each of `count` robots: a task of a user's module may return any.

        Raises:
            ArriveError: one is not; the message says which.
        """
        masks = {"success": self.success, "promote": self.promote, "demote": self.demote} | self.failures
        for name, mask in masks.items():
            if not isinstance(mask, Tensor) or mask.shape != (count,) or mask.dtype != torch.bool:
                found = f"{mask.dtype} {tuple(mask.shape)}" if isinstance(mask, Tensor) else type(mask).__name__
                raise ArriveError(
                    f"the task's outcome {name!r} must be a bool tensor of the shape ({count},), not {found}"
                )


@dataclass(frozen=True)
class Trial:
    """The same command for every robot, instead of random commands. Each task reads the fields that it needs."""

    duration_s: float
    """Length of every episode [s]."""
    target: tuple[float, float] | Tensor
    """Position tasks: the target in the tile's frame, or (num_envs, 2) with one target per robot [m]. If no target is
    allowed there, the next valid point farther from the start, on the same line, is used."""
    speed: float
    """Velocity task: commanded forward speed along the tile's x axis [m/s]."""
    walk: float
    """Velocity task: distance along the x axis that counts as success [m]."""
    wait_s: float = 0.0
    """Position tasks: how long the robot must then stay at the target; this lengthens the episode [s]."""
    hold_s: float = 0.0
    """Position tasks: time left that the robot observes while it stays, held constant [s]."""


@dataclass(frozen=True)
class ConstantCommand:
    """A constant command per robot that never ends, instead of random commands. Each task reads the fields it needs.

    In position tasks the target moves with the robot at a constant offset, and the time left stays constant (the
    paper's pseudo velocity control, section Energy Consumption).
    """

    duration_s: float
    """Longest walk that is evaluated; the task itself never ends the episode [s]."""
    offset_w: Tensor
    """(num_envs, 2) position tasks: target relative to the robot, along the world's axes [m]."""
    time_left_s: Tensor
    """(num_envs,) position tasks: time left that the robots observe [s]."""
    speed: Tensor
    """(num_envs,) velocity task: forward speed [m/s]."""
    heading: Tensor
    """(num_envs,) velocity task: heading in the world frame [rad]."""


@dataclass(frozen=True)
class TaskContext:
    """What the environment gives to a task."""

    num_envs: int
    control_dt: float
    """Length of a policy step [s]."""
    rasters: Rasters
    generator: torch.Generator


class Task(Protocol):
    """Commands, their observation, the available rewards, and the criterion for success."""

    Config: ClassVar[type[TaskConfig]]
    ahead: tuple[str, int]
    """Observation entry (term, index) that is positive when the command points forward."""
    bootstraps: bool
    """Whether to bootstrap the value at a time-out. True for tasks that do not observe the time left. The paper argues
    against bootstrapping where the time is observed."""

    def __init__(self, config: Any, context: TaskContext, trial: Trial | ConstantCommand | None = None) -> None:
        """Build the task with no commands yet. A trial or a constant command replaces random commands."""

    @staticmethod
    def from_preset(config: TaskConfig) -> TaskConfig:
        """This task's configuration, derived from that of a preset made for another task."""

    @property
    def episode_s(self) -> float:
        """The longest episode [s]."""

    @staticmethod
    def observation_terms(config: Any, sensing: ObservationConfig, robot: Robot) -> tuple[ObservationTerm, ...]:
        """The policy's observation."""

    def new_command(self, start: Start, first: bool) -> None:
        """Give commands to robots that start an episode; `first` spreads the ends of a run's first episodes."""

    def follow(self, state: State) -> None:
        """Update what the task remembers of the robots, after a step."""

    def retarget(self, state: State) -> None:
        """Give some robots new commands in the middle of their training episodes, if the task does that."""

    def advance(self, dt: float) -> Tensor:
        """Advance the time by `dt` [s]. Returns (num_envs,) bool: the episode's time is up."""

    @property
    def command(self) -> Any:
        """The current commands, in the form that the task's observations and rewards use."""

    @property
    def destination_w(self) -> Tensor:
        """(num_envs, 3) where the commands lead [m], for pictures."""

    def task_share(self, state: State, failed: Tensor) -> tuple[Tensor, Tensor]:
        """The task reward over its maximum, and how many samples of the reward window each share stands for.

        Args:
            failed: (num_envs,) bool: the episode fails now. The part of the window that it misses enters as 0.

        Returns:
            (num_envs,) share and (num_envs,) number of samples, 0 outside the reward window.
        """

    def judge(self, state: State, crashed: Tensor, fell: Tensor) -> Outcome:
        """The outcome of every episode if it ended now."""

    def state_dict(self) -> dict[str, Tensor]:
        """The commands and what the task remembers, for an exact resume."""

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Resume exactly."""
