"""The log of a run: `log.csv`, one row per iteration, and the same figures for TensorBoard."""

import csv
import io
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

from arrive.errors import ArriveError
from arrive.learning.report import IterationReport

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

LOG_NAME = "log.csv"
TENSORBOARD_NAME = "tensorboard"


class RunLog:
    """Writes every report to `log.csv` and to TensorBoard event files in `folder`, and continues an existing log."""

    def __init__(self, folder: Path):
        self._folder = Path(folder)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._path = self._folder / LOG_NAME
        self._columns: list[str] = ["iteration"]
        self._events: SummaryWriter | None = None
        self._purge_step: int | None = None
        self._last = -1
        if self._path.exists():
            self._columns, rows = _read_rows(self._path)
            self._rewrite(rows)  # without the half line that a killed process may have left

    def write(self, report: IterationReport) -> None:
        """Append one iteration; a figure seen for the first time becomes a new column, empty in earlier rows.

        An iteration not after the last one means that training went back: what was logged since is dropped.

        Raises:
            ArriveError: the disk is full or the folder cannot be written.
        """
        try:
            if report.iteration <= self._last:
                self.truncate_after(report.iteration - 1)
            self._append(report)
        except OSError as error:
            raise ArriveError(f"cannot log to {self._folder}: {error}. Free some space and resume.") from error
        self._last = report.iteration

    def _append(self, report: IterationReport) -> None:
        scalars = report.scalars()
        row = {"iteration": str(report.iteration)} | {name: repr(float(value)) for name, value in scalars.items()}
        new_columns = [name for name in row if name not in self._columns]
        if new_columns or not self._path.exists():
            rows = _read_rows(self._path)[1] if self._path.exists() else []
            self._columns += new_columns
            self._rewrite([*rows, row])
        else:
            with self._path.open("a", newline="") as file:
                file.write(_csv_text(self._columns, [row], header=False))
        self._write_events(report.iteration, scalars)

    def truncate_after(self, iteration: int) -> None:
        """Drop what was logged after `iteration`, the one of the checkpoint that the run resumes from."""
        self.close()
        self._purge_step = iteration + 1
        if self._path.exists():
            _, rows = _read_rows(self._path)
            self._rewrite([row for row in rows if int(row["iteration"]) <= iteration])

    def close(self) -> None:
        """Flush and close the event file; a later `write` opens a new one."""
        if self._events is not None:
            self._events.close()
            self._events = None

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        partial = self._path.with_suffix(".csv.partial")
        partial.write_text(_csv_text(self._columns, rows, header=True))
        os.replace(partial, self._path)

    def _write_events(self, iteration: int, scalars: dict[str, float]) -> None:
        if self._events is None:
            # Imported on use: it takes seconds, which `arrive report` need not wait for.
            from torch.utils.tensorboard import SummaryWriter

            folder = self._folder / TENSORBOARD_NAME
            self._events = SummaryWriter(str(folder), purge_step=self._purge_step, flush_secs=30)
        for name, value in scalars.items():
            if math.isfinite(value):  # a NaN is an arrival rate before the first episode has ended
                self._events.add_scalar(name, value, iteration)


def read_log(folder: Path) -> dict[str, list[float]]:
    """Every column of a run's `log.csv`, all of one length; NaN where an iteration did not report the figure.

    Raises:
        ArriveError: the folder has no log.
    """
    path = Path(folder) / LOG_NAME
    if not path.exists():
        raise ArriveError(f"{folder} has no {LOG_NAME}; is it the folder of a run?")
    columns, rows = _read_rows(path)
    return {name: [float(row.get(name) or "nan") for row in rows] for name in columns}


def _csv_text(columns: list[str], rows: list[dict[str, str]], header: bool) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _read_rows(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Columns and complete rows; a last line without its end was cut off with the process that wrote it."""
    text = path.read_text()
    reader = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1]))
    columns = list(reader.fieldnames or ["iteration"])
    if columns[0] != "iteration":
        raise ArriveError(f"{path} is no log of this program: its first column is {columns[0]!r}, not 'iteration'")
    return columns, list(reader)
