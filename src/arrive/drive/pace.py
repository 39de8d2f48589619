"""Runs simulated time in step with real time."""

import math

LARGEST_DELAY_S = 0.2
"""Largest delay that is caught up. Any delay beyond it is dropped [s]."""


class Pace:
    """Computes how many control steps are due, in real time or slower."""

    def __init__(self, period_s: float):
        """Start in real time, at the first call of `steps_due`.

        Args:
            period_s: simulated time of a control step [s].
        """
        self.factor = 1.0
        """Ratio of simulated to real time: 1 is real time, 0 is paused."""
        self._period_s, self._due_s = period_s, 0.0
        self._last_s: float | None = None
        self.asked_s = 0.0
        """Simulated time that was due so far [s]."""
        self.dropped_s = 0.0
        """Part of it that was dropped [s]."""

    @property
    def next_s(self) -> float:
        """Real time at which the next step is due, at the current factor [s]."""
        if self._last_s is None or self.factor == 0.0:
            return math.inf
        return self._last_s + (self._period_s - self._due_s) / self.factor

    def steps_due(self, now_s: float) -> int:
        """Number of control steps to simulate now, given the real time [s]."""
        asked_s = self.factor * (now_s - (now_s if self._last_s is None else self._last_s))
        self.asked_s += asked_s
        self._due_s += asked_s
        self._last_s = now_s
        late = max(0.0, self._due_s - LARGEST_DELAY_S)
        self.dropped_s += late
        self._due_s -= late
        steps = int(self._due_s / self._period_s + 1e-9)
        self._due_s -= steps * self._period_s
        return steps
