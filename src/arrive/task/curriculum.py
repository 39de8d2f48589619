"""The curriculum: terrain levels that follow success, and the exploration reward that is removed in time."""

from collections.abc import Callable
from typing import TypedDict

import torch
from torch import Tensor

FOUND = 0.5
"""The exploration reward is removed once the task reward reaches this share of its maximum (paper, eq. 3)."""


def assign_families(num_envs: int, families: int) -> Tensor:
    """(num_envs,) index of each robot's terrain family, assigned in turn."""
    return torch.arange(num_envs) % families


class LevelCurriculum:
    """Each robot's terrain level: up after a success, down after a failure (paper, section Episode Process)."""

    def __init__(self, num_levels: Tensor, generator: torch.Generator):
        """Start every robot on the first level.

        Args:
            num_levels: (num_envs,) number of levels of each robot's family.
        """
        self._num_levels = num_levels
        self._generator = generator
        # All zeros. They are drawn only to keep the random numbers of a seed the same as before.
        self.levels = self._draw(torch.ones_like(num_levels)).long()

    def _uniform(self, like: Tensor) -> Tensor:
        return torch.rand(like.shape, generator=self._generator, device=like.device)

    def _draw(self, below: Tensor) -> Tensor:
        return (self._uniform(below) * below).floor()

    def next_levels(self, env_ids: Tensor, review: float) -> Tensor:
        """Levels of some robots' next episodes: their own level, or a random easier one.

        Args:
            env_ids: (n,) robots.
            review: share of the episodes on an easier level. Robots on the first level stay there.

        Returns:
            (n,) levels.
        """
        own = self.levels[env_ids]
        if review <= 0.0:
            return own
        reviews = self._uniform(own) < review
        return torch.where(reviews, self._draw(own).long(), own)

    def update(self, ended: Tensor, promote: Tensor, demote: Tensor, demotion_share: float = 1.0) -> None:
        """Change the levels of robots whose episode ended. After the last level comes a random one (legged_gym).

        Args:
            ended, promote, demote: (num_envs,) bool.
            demotion_share: probability that a robot in `demote` is in fact demoted.
        """
        if demotion_share < 1.0:
            demote = demote & (self._uniform(self.levels) < demotion_share)
        moved = self.levels + (ended & promote).long() - (ended & demote).long()
        beyond = moved >= self._num_levels
        anywhere = self._draw(self._num_levels).long()
        self.levels = torch.where(beyond, anywhere, moved.clamp(min=0))


class SwitchState(TypedDict):
    """The decisions and running sums of an `ExplorationSwitch` in a checkpoint."""

    active: Tensor
    fractions: Tensor
    sums: Tensor
    steps: int


class ExplorationSwitch:
    """Pays the exploration reward on a terrain family until the task reward reaches half of its maximum there.

    The paper (eq. 3) trains on one family at a time. With several families, each one is switched off by itself.

    The share is a mean over the samples inside the reward window. Outside it the task reward is zero by definition, so
    including those samples would keep the exploration reward forever. Samples that a robot misses because it crashed
    enter as zero. Without them, the few robots that survive a gap would decide for all.
    """

    CHECK_STEPS = 50
    """Policy steps between decisions: one reward window of 1 s."""

    def __init__(self, family_of_env: Tensor, first_steps: int = CHECK_STEPS):
        """Start with the reward paid on every family.

        Args:
            family_of_env: (num_envs,) index of each robot's terrain family.
            first_steps: policy steps before the first decision. A run's first episodes are cut short, and those that
                end first have had no time to crash: robots that only stand near their targets would decide.
        """
        self._family_of_env = family_of_env
        self._families = families = int(family_of_env.max()) + 1
        device = family_of_env.device
        self.active = torch.ones(families, dtype=torch.bool, device=device)
        """(families,) bool: the reward is still paid."""
        self.fractions = torch.full((families,), torch.nan, device=device)
        """(families,) mean task reward over its maximum, at the last decision that had samples."""
        self._sums = torch.zeros(2, families, device=device)
        self._steps = self.CHECK_STEPS - first_steps

    @property
    def factor(self) -> Tensor:
        """(num_envs,) factor on each robot's exploration reward, 0 or 1."""
        return self.active.float()[self._family_of_env]

    @property
    def paid(self) -> float:
        """Share of the robots that still get the exploration reward."""
        return float(self.active[self._family_of_env].float().mean())

    @property
    def fraction(self) -> float:
        """Mean of the families' fractions, 0 before the first decision."""
        return float(self.fractions.nanmean().nan_to_num())

    def record(self, share: Tensor, weight: Tensor) -> None:
        """Add one policy step to the mean. Decide every CHECK_STEPS steps, the first time after `first_steps`.

        Args:
            share: (num_envs,) task reward over its maximum.
            weight: (num_envs,) how many samples inside the reward window each share stands for; 0 leaves it out.
        """
        self._sums.index_add_(1, self._family_of_env, torch.stack([share * weight, weight]))
        self._steps += 1
        if self._steps == self.CHECK_STEPS:
            self._decide()

    def agree(self, any_of: Callable[[Tensor], Tensor]) -> None:
        """Stop paying on a family as soon as one of the processes that train together stops.

        Args:
            any_of: for each flag of a bool tensor, returns whether it is set in any process.
        """
        self.active = ~any_of(~self.active)

    def _decide(self) -> None:
        earned, count = self._sums
        self.fractions = torch.where(count > 0, earned / count, self.fractions)
        self.active &= ~(self.fractions >= FOUND)  # a family without samples has NaN, and keeps its state
        self._sums.zero_()
        self._steps = 0

    def state_dict(self) -> SwitchState:
        """The decisions so far and the running sums."""
        return {
            "active": self.active.clone(),
            "fractions": self.fractions.clone(),
            "sums": self._sums.clone(),
            "steps": self._steps,
        }

    def load_state_dict(self, state: SwitchState) -> None:
        self.active, self.fractions = state["active"].clone(), state["fractions"].clone()
        self._sums, self._steps = state["sums"].clone(), state["steps"]
