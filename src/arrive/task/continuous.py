"""Continuous position tracking: be at the target all the time (paper, section Simulation Experiments, P_c)."""

from dataclasses import replace

import torch

from arrive.config import Config
from arrive.errors import ArriveError
from arrive.task.final import FinalPositionTask
from arrive.task.task import Cruise, Trial
from arrive.terrain.rasters import Rasters


class ContinuousPositionTask(FinalPositionTask):
    """Position targets whose reward is paid at every step: T_r = T, and nothing else differs from `final`."""

    def __init__(
        self, config: Config, rasters: Rasters, generator: torch.Generator, trial: Trial | Cruise | None = None
    ):
        """Build the task with no commands yet.

        Raises:
            ArriveError: the reward window is not the whole episode.
        """
        window, episode = config.task.reward_window_s, config.task.episode_s
        if window != episode:
            raise ArriveError(
                f"the task 'continuous' pays all the time: task.reward_window_s must be task.episode_s, {episode:g} s, "
                f"not {window:g} s"
            )
        super().__init__(config, rasters, generator, trial)

    @staticmethod
    def configure(config: Config) -> Config:
        return replace(config, task=replace(config.task, reward_window_s=config.task.episode_s))
