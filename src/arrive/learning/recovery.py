"""Goes back to the last good state where a number is NaN or infinite, with other random numbers from there."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import torch

from arrive.errors import ArriveError
from arrive.learning.guard import NonFiniteError, check_losses, save_dump
from arrive.learning.ranks import Ranks
from arrive.learning.state import TrainingState

MAX_RECOVERIES = 3
"""Times that training goes back to the last good state, without a new one, before it gives up."""
SEED_STEP = 7919
"""Added to the seed per recovery, so that the same numbers are not drawn again."""
Result = TypeVar("Result")


class Recovery:
    """Keeps the last good state of a training and restores it."""

    def __init__(self, state: TrainingState, seed: int, folder: Path, ranks: Ranks):
        """
        Args:
            seed: of this process's random numbers.
            folder: for the dumps of what went wrong.
        """
        self._state, self._seed, self._ranks = state, seed, ranks
        self._folder = folder if ranks.leads else folder / f"rank{ranks.rank}"
        self.keep()

    def keep(self) -> None:
        """Take the present state as the one to go back to."""
        self.good = self._state.snapshot()
        self._count = 0

    def together(self, phase: Callable[[], Result]) -> Result:
        """Run a phase; where one process meets a number that is not finite, all go back.

        Raises:
            NonFiniteError: this process or another one met it.
        """
        result, failure = None, None
        try:
            result = phase()
        except NonFiniteError as error:
            failure = error
        except RuntimeError as error:
            failure = self._broken_networks(error)
        if self._ranks.any(failure is not None):
            raise failure or NonFiniteError("another process met a non-finite number", {})
        return result

    def _broken_networks(self, error: RuntimeError) -> NonFiniteError:
        """Why torch refused to draw actions, which it does where a mean or deviation is NaN, before our checks."""
        try:
            check_losses({}, self._state.parameters())
        except NonFiniteError as broken:
            return broken
        raise error

    def go_back(self, error: NonFiniteError) -> None:
        """Dump what was seen, go back, and draw other random numbers from there.

        Raises:
            ArriveError: it came back too often.
        """
        self._count += 1
        path = save_dump(self._folder, self._state.iteration, error, vars(self.good))
        if self._count > MAX_RECOVERIES:
            raise ArriveError(f"{error}; it came back {MAX_RECOVERIES} times. What was seen is in {path}.") from error
        print(f"{error}. Dumped to {path}; going on from iteration {self.good.iteration}.")
        self._state.restore(self.good)
        self._state.algorithm.storage.clear()
        torch.manual_seed(self._seed + SEED_STEP * self._count + self._state.iteration)
