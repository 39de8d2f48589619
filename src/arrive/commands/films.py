"""Films of a run in progress, made in a second process."""

import subprocess
import sys
import time
from pathlib import Path

from arrive.policies import POLICY_NAME

FOLDER = "films"


class Films:
    """Starts `arrive eval` every few minutes to film the newest policy, in a separate process, one at a time."""

    def __init__(self, folder: Path, minutes: float | None):
        """Set the time of the first film.

        Args:
            folder: the run folder.
            minutes: time between two films, None for no films [min].
        """
        self._folder, self._period_s = folder, None if minutes is None else 60.0 * minutes
        self._next_s = time.monotonic() + (self._period_s or 0.0)
        self._process: subprocess.Popen[bytes] | None = None

    def tick(self, samples: int) -> None:
        """Start a film if it is time. Its name contains `samples`, the policy steps so far."""
        if self._period_s is None or time.monotonic() < self._next_s or not (self._folder / POLICY_NAME).is_file():
            return
        if self._process is not None and self._process.poll() is None:
            return
        self._next_s = time.monotonic() + self._period_s
        pictures = self._folder / FOLDER / f"{samples / 1e6:07.2f}M"
        command = ["eval", str(self._folder), "--episodes", "1", "--threads", "1", "--pictures", str(pictures)]
        nothing = subprocess.DEVNULL
        self._process = subprocess.Popen(
            [sys.executable, "-m", "arrive", *command], stdin=nothing, stdout=nothing, stderr=nothing
        )

    def close(self) -> None:
        """Wait for a film that is being made."""
        if self._process is not None:
            self._process.wait()
