"""The recent past of the plotted values."""

from collections import deque

import numpy as np

from arrive.play.playground import Reading

WINDOW_S = 10.0
"""Time that the plots show [s]."""


class History:
    """Readings of the last `WINDOW_S` seconds as columns."""

    def __init__(self, period_s: float):
        """Start empty.

        Args:
            period_s: time between readings [s].
        """
        self._rows: deque[Reading] = deque(maxlen=round(WINDOW_S / period_s))

    def append(self, reading: Reading) -> None:
        """Add a reading, and drop the one that is older than the window."""
        self._rows.append(reading)

    @property
    def time_s(self) -> np.ndarray:
        """(n,) [s]."""
        return np.array([row.time_s for row in self._rows])

    @property
    def speed(self) -> np.ndarray:
        """(n,) horizontal [m/s]."""
        return np.array([row.speed for row in self._rows])

    @property
    def distance(self) -> np.ndarray:
        """(n,) to the target [m]; 0 if there was none, because the plots cannot show gaps."""
        return np.nan_to_num([row.distance for row in self._rows])

    @property
    def torque(self) -> np.ndarray:
        """(n, joints) [N m]."""
        return np.array([row.torque for row in self._rows])

    @property
    def contact(self) -> np.ndarray:
        """(n, feet) bool."""
        return np.array([row.contact for row in self._rows])
