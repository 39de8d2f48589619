"""Continuous position tracking: the task reward is paid at every step (paper, section Simulation Experiments, P_c)."""

from dataclasses import dataclass
from typing import Literal

from arrive.task.final import FinalPositionTask, PositionConfig


@dataclass(frozen=True)
class ContinuousConfig(PositionConfig):
    """Position targets, with the task reward paid at every step."""

    name: Literal["continuous"] = "continuous"
    """The task, see `arrive list tasks`."""


class ContinuousPositionTask(FinalPositionTask):
    """Position targets, with the task reward paid at every step: `final` with T_r = T."""

    Config = ContinuousConfig
