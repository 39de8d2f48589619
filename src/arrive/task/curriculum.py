"""Terrain levels that follow success, and the exploration reward that goes when it has done its work."""

import torch
from torch import Tensor

from arrive.config import TaskConfig


class LevelCurriculum:
    """Each robot's terrain level: up after a success, down after a failure (paper, section Episode Process)."""

    def __init__(self, num_levels: Tensor, start_level: int, generator: torch.Generator):
        """Deal starting levels.

        Args:
            num_levels: (num_envs,) levels of each robot's family.
            start_level: highest starting level.
        """
        self._num_levels = num_levels
        self._generator = generator
        self.levels = (self._draw(num_levels.clamp(max=start_level + 1))).long()

    def _draw(self, below: Tensor) -> Tensor:
        uniform = torch.rand(below.shape, generator=self._generator, device=below.device)
        return (uniform * below).floor()

    def update(self, ended: Tensor, promote: Tensor, demote: Tensor) -> None:
        """Move the robots whose episode ended; who solves the last level goes on at a random one (legged_gym).

        Args:
            ended, promote, demote: (num_envs,) bool.
        """
        moved = self.levels + (ended & promote).long() - (ended & demote).long()
        beyond = moved >= self._num_levels
        anywhere = self._draw(self._num_levels).long()
        self.levels = torch.where(beyond, anywhere, moved.clamp(min=0))


class ExplorationSwitch:
    """Pays the exploration reward until the task reward reaches a share of its maximum (paper, eq. 3).

    The share is taken over the samples inside the reward window only: outside it the task reward is zero by
    definition, and averaging those in would keep the exploration reward for ever.
    """

    CHECK_STEPS = 50
    """Policy steps between decisions: one reward window of 1 s."""

    def __init__(self, config: TaskConfig):
        self._config = config
        self.active = True
        self.fraction = 0.0
        """Mean task reward over its maximum while it was paid, at the last decision."""
        self._sum, self._count, self._steps = 0.0, 0, 0

    @property
    def factor(self) -> float:
        """What the exploration reward is multiplied by."""
        return 1.0 if self.active else self._config.exploration_kept

    def record(self, share: Tensor, paid: Tensor) -> None:
        """Take in one policy step; every CHECK_STEPS decide.

        Args:
            share: (num_envs,) task reward over its maximum.
            paid: (num_envs,) bool: it is being paid, in an episode of full length.
        """
        self._sum += (share * paid).double().sum().item()
        self._count += int(paid.sum())
        self._steps += 1
        if self._steps == self.CHECK_STEPS:
            self._decide()

    def _decide(self) -> None:
        if self._count:
            self.fraction = self._sum / self._count
            self.active = self.active and self.fraction < self._config.exploration_until
        self._sum, self._count, self._steps = 0.0, 0, 0

    def state_dict(self) -> dict[str, float]:
        return {
            "active": self.active,
            "fraction": self.fraction,
            "sum": self._sum,
            "count": self._count,
            "steps": self._steps,
        }

    def load_state_dict(self, state: dict[str, float]) -> None:
        self.active, self.fraction = bool(state["active"]), float(state["fraction"])
        self._sum, self._count, self._steps = float(state["sum"]), int(state["count"]), int(state["steps"])
