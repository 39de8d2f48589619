"""Films of a run in progress, made beside the training."""

import subprocess
import sys
import time
from pathlib import Path

from arrive.policies import POLICY_NAME

FOLDER = "films"


class Films:
    """Has `arrive eval` film the newest policy every few minutes, in a process of its own and never two at once."""

    def __init__(self, folder: Path, minutes: float | None):
        """Wait for the first time.

        Args:
            folder: of the run.
            minutes: between two films, None for none [min].
        """
        self._folder, self._period_s = folder, None if minutes is None else 60.0 * minutes
        self._next_s = time.monotonic() + (self._period_s or 0.0)
        self._process: subprocess.Popen | None = None

    def tick(self, samples: int) -> None:
        """Begin a film if it is time; `samples` name it: policy steps so far."""
        if self._period_s is None or time.monotonic() < self._next_s or not (self._folder / POLICY_NAME).is_file():
            return
        if self._process is not None and self._process.poll() is None:
            return
        self._next_s = time.monotonic() + self._period_s
        pictures = self._folder / FOLDER / f"{samples / 1e6:07.2f}M"
        command = ["eval", str(self._folder), "--episodes", "1", "--threads", "1", "--pictures", str(pictures)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "stdin": subprocess.DEVNULL}
        self._process = subprocess.Popen([sys.executable, "-m", "arrive", *command], **quiet)

    def close(self) -> None:
        """Let a film that is being made be finished."""
        if self._process is not None:
            self._process.wait()
