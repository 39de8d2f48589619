"""Films of a run in progress, made in a second process."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from arrive.learning.report import FamilyReport, IterationReport
from arrive.plugins import import_options
from arrive.policies import POLICY_NAME
from arrive.startup import INTERRUPTED
from arrive.terrain import get_family

FOLDER = "films"


class Films:
    """Starts `arrive eval` every few minutes to film the newest policy, in a separate process, one at a time."""

    def __init__(self, folder: Path, minutes: float | None, say: Callable[[str], None]):
        """Set the time of the first film.

        Args:
            folder: the run folder.
            minutes: time between two films, None for no films [min].
            say: shows a line, which says why a film was not made.
        """
        self._folder, self._period_s, self._say = folder, None if minutes is None else 60.0 * minutes, say
        self._next_s = time.monotonic() + (self._period_s or 0.0)
        self._film: _Film | None = None

    def tick(self, report: IterationReport) -> None:
        """Start a film of each terrain, at the level that its robots have reached, if it is time.

        The film's folder has the policy steps so far in its name.
        """
        if self._film is not None and self._film.is_over():
            self._end()
        if self._period_s is None or time.monotonic() < self._next_s or not (self._folder / POLICY_NAME).is_file():
            return
        if self._film is not None:
            return
        self._next_s = time.monotonic() + self._period_s
        pictures = self._folder / FOLDER / f"{report.samples / 1e6:07.2f}M"
        self._film = _Film(self._folder, pictures, [_at_level(*item) for item in report.families.items()])

    def close(self) -> None:
        """Wait for a film that is being made."""
        if self._film is not None:
            self._film.process.wait()
            self._end()

    def _end(self) -> None:
        if self._film is not None and (why := self._film.why_failed()):
            self._say(f"no film: {why}")
        self._film = None


class _Film:
    """A process that films."""

    def __init__(self, folder: Path, pictures: Path, terrains: list[str]):
        """Start it.

        Args:
            folder: the run folder.
            pictures: folder for the film.
            terrains: each as NAME or NAME=VALUE; without any, those of the training.
        """
        options = ["--episodes", "1", "--threads", "1", "--pictures", str(pictures)]
        options += ["--terrain", ",".join(terrains)] if terrains else []
        self._pictures = pictures
        self._output: IO[str] = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115  # read at the end
        self.process = subprocess.Popen(
            [sys.executable, "-m", "arrive", *import_options(), "eval", str(folder), *options],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
        )

    def is_over(self) -> bool:
        return self.process.poll() is not None

    def why_failed(self) -> str:
        """The last line that it printed, if there is no film; empty if there is one, or after Ctrl-C."""
        with self._output:
            self._output.seek(0)
            lines = self._output.read().split("\n")
        made = self.process.returncode == 0 and any(self._pictures.glob("*.mp4"))
        if made or self.process.returncode == INTERRUPTED:
            return ""
        last = next((line for line in reversed(lines) if line.strip()), f"exit status {self.process.returncode}")
        return last.removeprefix("arrive: ")


def _at_level(name: str, family: FamilyReport) -> str:
    """A terrain at the level nearest to its robots' mean, as `arrive eval --terrain` takes it."""
    if len(family.levels) == 1:
        return name
    return f"{name}={get_family(name).value(round(family.mean_level), len(family.levels))!r}"
