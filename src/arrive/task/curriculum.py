"""Terrain levels that follow success, and the exploration reward that goes when it has done its work."""

from collections.abc import Callable

import torch
from torch import Tensor

FOUND = 0.5
"""Where the task reward is this share of its maximum, the task is found: exploration rewards go (paper, eq. 3)."""


def deal_families(num_envs: int, families: int) -> Tensor:
    """(num_envs,) index of each robot's terrain family: families take turns."""
    return torch.arange(num_envs) % families


class LevelCurriculum:
    """Each robot's terrain level: up after a success, down after a failure (paper, section Episode Process)."""

    def __init__(self, num_levels: Tensor, generator: torch.Generator):
        """Start everybody on the first level.

        Args:
            num_levels: (num_envs,) levels of each robot's family.
        """
        self._num_levels = num_levels
        self._generator = generator
        # Zeros, drawn: without the draw every seed would give another run than it used to.
        self.levels = self._draw(torch.ones_like(num_levels)).long()

    def _uniform(self, like: Tensor) -> Tensor:
        return torch.rand(like.shape, generator=self._generator, device=like.device)

    def _draw(self, below: Tensor) -> Tensor:
        return (self._uniform(below) * below).floor()

    def deal(self, env_ids: Tensor, review: float) -> Tensor:
        """Levels for the next episodes of some robots: their own, or a random easier one.

        Args:
            env_ids: (n,) robots.
            review: share of the episodes on an easier level; those of robots on the first one stay there.

        Returns:
            (n,) levels.
        """
        own = self.levels[env_ids]
        if review <= 0.0:
            return own
        reviews = self._uniform(own) < review
        return torch.where(reviews, self._draw(own).long(), own)

    def update(self, ended: Tensor, promote: Tensor, demote: Tensor, demotion_share: float = 1.0) -> None:
        """Move the robots whose episode ended; who solves the last level goes on at a random one (legged_gym).

        Args:
            ended, promote, demote: (num_envs,) bool.
            demotion_share: share of those to be demoted that are.
        """
        if demotion_share < 1.0:
            demote = demote & (self._uniform(self.levels) < demotion_share)
        moved = self.levels + (ended & promote).long() - (ended & demote).long()
        beyond = moved >= self._num_levels
        anywhere = self._draw(self._num_levels).long()
        self.levels = torch.where(beyond, anywhere, moved.clamp(min=0))


class ExplorationSwitch:
    """Pays the exploration reward on a terrain family until the task reward is at half of its maximum there.

    The paper (eq. 3) trains on one family at a time; where there are several, those that are not solved keep it. The
    share is taken over the samples inside the reward window only: outside it the task reward is zero by definition, and
    averaging those in would keep the exploration reward for ever. The samples that a robot misses because it crashed
    count as zero: without them the few that survive a gap would speak for all.
    """

    CHECK_STEPS = 50
    """Policy steps between decisions: one reward window of 1 s."""

    def __init__(self, family_of_env: Tensor):
        """Pay it everywhere.

        Args:
            family_of_env: (num_envs,) index of each robot's terrain family.
        """
        self._family_of_env = family_of_env
        self._families = families = int(family_of_env.max()) + 1
        device = family_of_env.device
        self.active = torch.ones(families, dtype=torch.bool, device=device)
        """(families,) whether it is still paid."""
        self.fractions = torch.full((families,), torch.nan, device=device)
        """(families,) mean task reward over its maximum at the last decision that had samples."""
        self._sums = torch.zeros(2, families, device=device)
        self._steps = 0

    @property
    def factor(self) -> Tensor:
        """(num_envs,) what each robot's exploration reward is multiplied by."""
        return self.active.float()[self._family_of_env]

    @property
    def paid(self) -> float:
        """Share of the robots to which it is paid in full."""
        return float(self.active[self._family_of_env].float().mean())

    @property
    def fraction(self) -> float:
        """Mean of the families' fractions, 0 before the first decision."""
        return float(self.fractions.nanmean().nan_to_num())

    def record(self, share: Tensor, weight: Tensor) -> None:
        """Take in one policy step; every CHECK_STEPS decide.

        Args:
            share: (num_envs,) task reward over its maximum.
            weight: (num_envs,) number of samples inside the reward window, of episodes of full length, it stands for.
        """
        self._sums.index_add_(1, self._family_of_env, torch.stack([share * weight, weight]))
        self._steps += 1
        if self._steps == self.CHECK_STEPS:
            self._decide()

    def agree(self, any_of: Callable[[Tensor], Tensor]) -> None:
        """Stop paying on a family as soon as one of the processes that train together does.

        Args:
            any_of: gives, for each flag of a bool tensor, whether it is set in any process.
        """
        self.active = ~any_of(~self.active)

    def _decide(self) -> None:
        earned, count = self._sums
        self.fractions = torch.where(count > 0, earned / count, self.fractions)
        self.active &= ~(self.fractions >= FOUND)  # NaN decides nothing
        self._sums.zero_()
        self._steps = 0

    def state_dict(self) -> dict[str, Tensor | int]:
        """What was decided and what is being gathered."""
        return {
            "active": self.active.clone(),
            "fractions": self.fractions.clone(),
            "sums": self._sums.clone(),
            "steps": self._steps,
        }

    def load_state_dict(self, state: dict[str, Tensor | int]) -> None:
        self.active, self.fractions = state["active"].clone(), state["fractions"].clone()
        self._sums, self._steps = state["sums"].clone(), state["steps"]
