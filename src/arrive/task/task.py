"""What an environment asks of a task; one module per task implements it."""

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from arrive.robots.robot import Robot
from arrive.task.observations import ObservationTerm
from arrive.task.rewards import RewardFunction
from arrive.task.state import Command, State


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


class Task(Protocol):
    """Commands, their observation, the rewards on offer, and what counts as success."""

    rewards: dict[str, RewardFunction]

    def observation_terms(self, robot: Robot) -> tuple[ObservationTerm, ...]:
        """The policy's observation."""

    def new_command(self, start: Start, first: bool) -> None:
        """Give starting robots a command; `first` spreads the phases of a run's first episodes."""

    def advance(self, dt: float) -> Tensor:
        """Let time pass; (num_envs,) bool: the episode's time is over."""

    @property
    def command(self) -> Command:
        """The present commands."""

    def judge(self, state: State, crashed: Tensor, fell: Tensor) -> Outcome:
        """How every episode stands."""

    def state_dict(self) -> dict[str, Tensor]:
        """The commands, to go on exactly."""

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Go on exactly."""
