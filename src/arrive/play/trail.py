"""The trail of the feet."""

from collections import deque

import numpy as np

WINDOW_S = 3.0
"""Time that the trail shows [s]."""
LONGEST_STEP = 0.4
"""If a foot moves farther than this between two samples, the robot was reset, and the line is interrupted [m]."""


class Trail:
    """Recent positions of the feet as line segments that fade with age."""

    def __init__(self, period_s: float):
        """Start empty.

        Args:
            period_s: time between samples [s].
        """
        self._places: deque[np.ndarray] = deque(maxlen=round(WINDOW_S / period_s) + 1)

    def append(self, feet: np.ndarray) -> None:
        """Add the positions of the feet, (feet, 3) [m]."""
        if self._places and len(self._places[-1]) != len(feet):
            self._places.clear()
        self._places.append(feet)

    def segments(self, colours: np.ndarray, faded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The line segments and their colours.

        Args:
            colours: (feet, 3) colours of the newest segments, 0 to 255.
            faded: (3,) colour of the oldest segment, 0 to 255.

        Returns:
            (n, 2, 3) ends [m] and (n, 2, 3) uint8 colours.
        """
        if len(self._places) < 2:
            return np.zeros((0, 2, 3)), np.zeros((0, 2, 3), dtype=np.uint8)
        places = np.stack(self._places)
        share = np.linspace(0.0, 1.0, len(places))[:, None, None]
        shades = faded + share * (colours - faded)
        ends, tints = (np.stack([part[:-1], part[1:]], axis=2).reshape(-1, 2, 3) for part in (places, shades))
        whole = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) < LONGEST_STEP
        return ends[whole], tints[whole].astype(np.uint8)
