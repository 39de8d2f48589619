"""Goes back to the last good state when a value is NaN or infinite, and continues with other random numbers."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import torch

from arrive.errors import ArriveError
from arrive.learning.guard import NonFiniteError, check_losses, save_dump
from arrive.learning.ranks import Ranks
from arrive.learning.state import TrainingState

MAX_RECOVERIES = 3
"""Training gives up after going back this many times to the same good state."""
SEED_STEP = 7919
"""Added to the seed per recovery, so that the random numbers differ."""
Result = TypeVar("Result")


class Recovery:
    """Keeps the last good state of a training and restores it."""

    def __init__(self, state: TrainingState, seed: int, folder: Path, ranks: Ranks):
        """
        Args:
            seed: seed of this process's random numbers.
            folder: folder for the dumps.
        """
        self._state, self._seed, self._ranks = state, seed, ranks
        self._folder = folder if ranks.leads else folder / f"rank{ranks.rank}"
        self.keep()

    def keep(self) -> None:
        """Store the current state as the last good one."""
        self.good = self._state.snapshot()
        self._count = 0

    def together(self, phase: Callable[[], Result]) -> Result:
        """Run a phase. If a value is not finite in one process, raise in all of them, so that all go back.

        Raises:
            NonFiniteError: a value in this process or another one is not finite.
        """
        failure: NonFiniteError | None = None
        try:
            result = phase()
        except NonFiniteError as error:
            failure = error
        except RuntimeError as error:
            failure = self._broken_networks(error)
        if self._ranks.any(failure is not None):
            raise failure or NonFiniteError("non-finite values in another process", {})
        return result

    def _broken_networks(self, error: RuntimeError) -> NonFiniteError:
        """Find the broken parameters after torch has refused to sample actions, which happens before our checks."""
        try:
            check_losses({}, self._state.parameters())
        except NonFiniteError as broken:
            return broken
        raise error

    def go_back(self, error: NonFiniteError) -> None:
        """Save a dump, restore the last good state, and continue with other random numbers.

        Raises:
            ArriveError: training went back too often.
        """
        self._count += 1
        path = save_dump(self._folder, self._state.iteration, error, vars(self.good))
        if self._count > MAX_RECOVERIES:
            raise ArriveError(f"{error}, again after {MAX_RECOVERIES} attempts to recover. Dump: {path}.") from error
        print(f"{error}. Dump: {path}. Training continues from iteration {self.good.iteration}.")
        self._state.restore(self.good)
        self._state.algorithm.storage.clear()
        torch.manual_seed(self._seed + SEED_STEP * self._count + self._state.iteration)
