"""What an environment asks of a task; one module per task implements it."""

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

import torch
from torch import Tensor

from arrive.robots.robot import Robot
from arrive.task.observations import ObservationConfig, ObservationTerm
from arrive.task.state import State
from arrive.terrain.rasters import Rasters


@dataclass(frozen=True)
class TaskConfig:
    """What every task's configuration has; each task adds its own fields, and a table of its rewards."""

    kinds: ClassVar[dict[str, "type[TaskConfig]"]] = {}
    """The configuration of every task, by the task's name: what `task` of a run may be."""

    name: str
    """The task, see `arrive list tasks`."""
    episode_s: float
    """Longest episode [s]."""
    rewards: Any
    """The reward terms with their weights and parameters."""

    def measured(self) -> Self:
        """The same for a measurement: every episode has the full length and one command."""
        return self


@dataclass(frozen=True)
class Start:
    """Where and on what robots start an episode."""

    env_ids: Tensor
    """(n,) environments."""
    base_pos_w: Tensor
    """(n, 3) [m]."""
    tile_ids: Tensor
    """(n,) rasters of their tiles."""


@dataclass(frozen=True)
class Outcome:
    """How episodes stand, judged as if they ended now; each (n,) bool."""

    success: Tensor
    promote: Tensor
    """The terrain level goes up."""
    demote: Tensor
    """The terrain level goes down."""
    failures: dict[str, Tensor]
    """By cause; every episode without success has exactly one."""
    remaining: Tensor
    """(n,) how much of the way is left [m], a number: the distance to the target, or what was not walked."""


@dataclass(frozen=True)
class Trial:
    """The same errand for every robot, instead of commands that are drawn; each task reads what concerns it."""

    duration_s: float
    """Length of every episode [s]."""
    target: tuple[float, float] | Tensor
    """Where robots that are sent to places must be at the end, in the tile's frame; (num_envs, 2) for a place each.
    Where no target may stand it is the next place straight behind it, seen from the start [m]."""
    speed: float
    """Forward speed at which robots that follow a velocity are sent along the tile's x axis [m/s]."""
    walk: float
    """How far along the x axis these must get [m]."""
    wait_s: float = 0.0
    """How long robots that are sent to places must then stay there; it makes the episode longer [s]."""
    hold_s: float = 0.0
    """Remaining time that they are told meanwhile, which does not run [s]."""


@dataclass(frozen=True)
class Cruise:
    """A constant command for every robot that never ends, instead of commands that are drawn; each task reads its own.

    Robots that are sent to places follow a target that keeps its distance, with a remaining time that does not run (the
    paper's pseudo velocity control, section Energy Consumption).
    """

    duration_s: float
    """Longest walk that is looked at; the task itself ends none [s]."""
    offset_w: Tensor
    """(num_envs, 2) where the target stays, seen from the robot, along the world's axes [m]."""
    time_left_s: Tensor
    """(num_envs,) remaining time that robots are told [s]."""
    speed: Tensor
    """(num_envs,) forward speed of robots that follow a velocity [m/s]."""
    heading: Tensor
    """(num_envs,) heading of these, in the world frame [rad]."""


@dataclass(frozen=True)
class Setting:
    """Where a task takes place."""

    num_envs: int
    control_dt: float
    """Length of a policy step [s]."""
    rasters: Rasters
    generator: torch.Generator


class Task(Protocol):
    """Commands, their observation, the rewards on offer, and what counts as success."""

    Config: ClassVar[type[TaskConfig]]
    sides: ClassVar[tuple[tuple[str, int], tuple[str, int]]]
    """Term and entry of the observation that are positive where the command leads forwards, and to the left."""
    bootstraps: ClassVar[bool]
    """Whether the value at a time-out is bootstrapped as if the episode went on: where the time is not observed. The
    paper argues against it where it is."""

    def __init__(self, config: Any, setting: Setting, trial: Trial | Cruise | None = None) -> None:
        """Build the task with no commands yet; a trial or a constant command replaces those that are drawn."""

    @staticmethod
    def from_preset(config: TaskConfig) -> TaskConfig:
        """This task's configuration in a preset that is made for another task."""

    @property
    def episode_s(self) -> float:
        """The longest episode [s]."""

    @staticmethod
    def observation_terms(config: Any, sensing: ObservationConfig, robot: Robot) -> tuple[ObservationTerm, ...]:
        """The policy's observation."""

    def new_command(self, start: Start, first: bool) -> None:
        """Give starting robots a command; `first` spreads the phases of a run's first episodes."""

    def follow(self, state: State) -> None:
        """Take in where the robots are after a step, for what a task remembers of them."""

    def advance(self, dt: float) -> Tensor:
        """Let time pass; (num_envs,) bool: the episode's time is over."""

    @property
    def command(self) -> Any:
        """The present commands, as the task's observations and rewards read them."""

    @property
    def destination_w(self) -> Tensor:
        """(num_envs, 3) where the commands lead [m], to be drawn in pictures."""

    def task_share(self, state: State, failed: Tensor) -> tuple[Tensor, Tensor]:
        """The task reward over its maximum, and how many samples inside the reward window that stands for.

        Args:
            failed: (num_envs,) bool: the episode ends here before its time; what it misses of the window counts as 0.

        Returns:
            (num_envs,) share and (num_envs,) number of samples, 0 where nothing is being paid.
        """

    def judge(self, state: State, crashed: Tensor, fell: Tensor) -> Outcome:
        """How every episode stands."""

    def state_dict(self) -> dict[str, Tensor]:
        """The commands and what the task remembers, to go on exactly."""

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Go on exactly."""
