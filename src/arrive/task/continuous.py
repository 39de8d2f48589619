"""Continuous position tracking: be at the target all the time (paper, section Simulation Experiments, P_c)."""

from dataclasses import dataclass
from typing import Literal

from arrive.task.final import FinalPositionTask, PositionConfig


@dataclass(frozen=True)
class ContinuousConfig(PositionConfig):
    """Position targets whose reward is paid all the time."""

    name: Literal["continuous"] = "continuous"
    """The task, see `arrive list tasks`."""

    @property
    def reward_window_s(self) -> float:
        """The whole episode [s]."""
        return self.episode_s


class ContinuousPositionTask(FinalPositionTask):
    """Position targets whose reward is paid at every step: T_r = T, and nothing else differs from `final`."""

    Config = ContinuousConfig
