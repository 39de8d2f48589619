"""The log of a run: `log.csv`, one row per iteration, and the same values for TensorBoard."""

import csv
import importlib.util
import io
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

from arrive.config import Config
from arrive.errors import ArriveError
from arrive.files import cannot_write, read_text, write_text
from arrive.learning.report import IterationReport

if TYPE_CHECKING:
    from rsl_rl.utils.wandb_log_writer import WandbLogWriter
    from torch.utils.tensorboard import SummaryWriter

LOG_NAME = "log.csv"
TENSORBOARD_NAME = "tensorboard"
PROGRESS = ("progress/samples", "progress/elapsed_s")
"""Columns without which no curve can be drawn."""
LARGEST_PROGRESS = 1e15
LARGEST = 1e39
"""More than float32 can hold, so that no metric is larger, except infinity."""
PROJECT = "arrive"
"""Project name on Weights & Biases."""

LogRow = dict[str, str]


class RunLog:
    """Writes every report to `log.csv` and to TensorBoard event files in `folder`, and continues an existing log."""

    def __init__(self, folder: Path, logger: str = "tensorboard"):
        """
        Args:
            logger: `tensorboard`, or `wandb` for both TensorBoard and Weights & Biases, with rsl_rl's writer.

        Raises:
            ArriveError: the folder cannot be written, its log is damaged, or wandb is not installed.
        """
        if logger == "wandb" and not has_wandb():
            raise ArriveError("--logger wandb needs Weights & Biases: pip install wandb")
        self._folder, self._logger = Path(folder), logger
        self._path = self._folder / LOG_NAME
        self._columns: list[str] = ["iteration"]
        self._events: SummaryWriter | None = None
        self._purge_step: int | None = None
        self._last = -1
        self._size: int | None = None
        self._warned: set[str] = set()
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(self._folder, error) from error
        if self._path.exists():
            self._columns, rows = _read_rows(self._path)
            self._rewrite(rows)  # drops an incomplete last line, which a killed process may have left

    def write(self, report: IterationReport) -> None:
        """Append one iteration. A new metric becomes a new column, empty in earlier rows.

        If the iteration is not later than the last one, training went back, and the rows from it on are dropped.

        Raises:
            ArriveError: the disk is full, the folder cannot be written, or another process has changed the log.
        """
        self._check_ours()
        try:
            if report.iteration <= self._last:
                self.truncate_after(report.iteration - 1)
            scalars = report.scalars()
            self._append(report.iteration, scalars)
            self._write_events(report, scalars)
        except OSError as error:
            raise ArriveError(f"cannot log to {self._folder}: {error}. Free some space and resume.") from error
        self._last = report.iteration

    def _check_ours(self) -> None:
        """Check that nobody else has changed the file since the last row."""
        size = self._path.stat().st_size if self._path.exists() else None
        if size != self._size:
            what = "removed" if size is None else "changed"
            raise ArriveError(f"{self._path} was {what} during training; continue with --resume {self._folder}")

    def _append(self, iteration: int, scalars: dict[str, float]) -> None:
        row = {"iteration": str(iteration)} | {name: repr(float(value)) for name, value in scalars.items()}
        new_columns = [name for name in row if name not in self._columns]
        if new_columns or self._size is None:
            rows = _read_rows(self._path)[1] if self._size is not None else []
            self._columns += new_columns
            self._rewrite([*rows, row])
            return
        data = _csv_text(self._columns, [row], header=False).encode()
        with self._path.open("ab") as file:
            file.write(data)
        self._size += len(data)

    def resume_at(self, iteration: int) -> None:
        """Continue after a checkpoint's iteration: drop later rows. If there is no file, start a new log.

        Raises:
            ArriveError: earlier rows are missing.
        """
        if self._size is not None:
            self._check_complete(iteration)
        elif iteration:
            print(f"{self._path} is missing: a new log starts at iteration {iteration + 1}")
        self.truncate_after(iteration)

    def _check_complete(self, iteration: int) -> None:
        """Check that no row before a checkpoint's iteration is missing. Only print a note if the first rows are."""
        numbers = [number for row in _read_rows(self._path)[1] if (number := int(row["iteration"])) <= iteration]
        expected = range(numbers[0] if numbers else 1, iteration + 1)
        missing = sorted(set(expected) - set(numbers))
        if missing:
            raise ArriveError(
                f"{self._path} has no row for iteration {missing[0]}, but the checkpoint is at iteration {iteration}. "
                f"Restore the file, or delete it: a new log then starts at {iteration + 1}."
            )
        if expected.start > 1 and numbers:
            print(f"{self._path} starts at iteration {expected.start}: earlier rows are missing")

    def truncate_after(self, iteration: int) -> None:
        """Drop all rows after `iteration`."""
        self.close()
        self._purge_step = iteration + 1
        if self._size is not None:
            _, rows = _read_rows(self._path)
            self._rewrite([row for row in rows if int(row["iteration"]) <= iteration])

    def flush(self) -> None:
        """Write the log to disk, so that no checkpoint is ever ahead of it.

        Raises:
            ArriveError: the disk is full or gone.
        """
        if self._size is None:
            return
        self._check_ours()
        try:
            with self._path.open("rb") as file:
                os.fsync(file.fileno())
        except OSError as error:
            raise cannot_write(self._path, error) from error

    def close(self) -> None:
        """Flush and close the event file. A later `write` opens a new one."""
        events, self._events = self._events, None
        if events is not None:
            try:
                events.close()
            except OSError as error:
                raise cannot_write(self._folder / TENSORBOARD_NAME, error) from error

    def _rewrite(self, rows: list[LogRow]) -> None:
        text = _csv_text(self._columns, rows, header=True)
        write_text(self._path, text)
        self._size = len(text.encode())

    def _write_events(self, report: IterationReport, scalars: dict[str, float]) -> None:
        if self._events is None:
            self._events = self._open_events()
        for name, value in scalars.items():
            if math.isfinite(value):  # the success rate is NaN before the first episode has ended
                self._events.add_scalar(name, value, report.iteration)
        for name in report.warnings.keys() - self._warned:
            self._events.add_text(f"warnings/{name}", report.warnings[name], report.iteration)
        self._warned = set(report.warnings)

    def describe(self, config: Config) -> None:
        """Send the run's configuration to Weights & Biases, if it is used."""
        if self._logger == "wandb":
            events = self._open_wandb()
            events.store_config(config, {})
            self._events = events

    def _open_events(self) -> "SummaryWriter":
        # Imported here because it takes seconds and `arrive report` does not need it.
        if self._logger == "wandb":
            return self._open_wandb()
        from torch.utils.tensorboard import SummaryWriter

        return SummaryWriter(str(self._folder / TENSORBOARD_NAME), purge_step=self._purge_step, flush_secs=30)

    def _open_wandb(self) -> "WandbLogWriter":
        from rsl_rl.utils.wandb_log_writer import WandbLogWriter

        # The writer uses the folder's name as the run's name.
        return WandbLogWriter(str(self._folder / TENSORBOARD_NAME / self._folder.resolve().name), PROJECT)


def has_wandb() -> bool:
    """Whether Weights & Biases is installed."""
    return importlib.util.find_spec("wandb") is not None


def read_log(folder: Path) -> dict[str, list[float]]:
    """Every column of a run's `log.csv`, all of the same length. Missing values are NaN.

    Raises:
        ArriveError: the log is missing or damaged.
    """
    path = Path(folder) / LOG_NAME
    if not path.exists():
        raise ArriveError(f"{folder} has no {LOG_NAME}; is it a run folder?")
    columns, rows = _read_rows(path)
    missing = [name for name in PROGRESS if name not in columns]
    if missing and rows:
        raise ArriveError(f"{path} has no column {missing[0]}. Restore the file from a copy, or delete it.")
    log = {name: [float(row[name] or "nan") for row in rows] for name in columns}
    for name in PROGRESS if rows else ():
        bad = next((i for i, value in enumerate(log[name]) if not 0.0 <= value <= LARGEST_PROGRESS), None)
        if bad is not None:
            raise ArriveError(
                f"{path}, line {bad + 2}: {name} must be a number from 0 to {LARGEST_PROGRESS:g}, not "
                f"{log[name][bad]:g}. Restore the file from a copy, or delete it."
            )
    return log


def _csv_text(columns: list[str], rows: list[LogRow], header: bool) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _read_rows(path: Path) -> tuple[list[str], list[LogRow]]:
    """Columns and complete rows. An incomplete last line, left by a killed process, is ignored.

    Raises:
        ArriveError: it is not a log of arrive; the message names the faulty line.
    """
    text = read_text(path)
    lines = text[: text.rfind("\n") + 1].split("\n")[:-1]
    if not lines and not text.startswith("iteration") and not "iteration".startswith(text):
        raise ArriveError(f"{path} is not a log of arrive: it has no first line with names")
    columns = _cells(lines[0]) if lines else ["iteration"]
    if columns[0] != "iteration" or len(set(columns)) != len(columns):
        raise ArriveError(f"{path} is not a log of arrive: its first line must be iteration and other unique names")
    rows, last = [], 0
    for number, line in enumerate(lines[1:], start=2):
        cells = _cells(line)
        row = dict(zip(columns, cells, strict=False))
        problem = _problem(row, len(cells), columns, last)
        if problem:
            raise ArriveError(f"{path}, line {number}: {problem}. Restore the file from a copy, or delete it.")
        rows.append(row)
        last = int(row["iteration"])
    return columns, rows


def _cells(line: str) -> list[str]:
    """The values of one line; a single empty value if it is not CSV."""
    try:
        return next(csv.reader([line], strict=True), [""])
    except csv.Error:
        return [""]


def _problem(row: LogRow, cells: int, columns: list[str], last: int) -> str | None:
    """The fault of a row of the log, or None."""
    if cells != len(columns):
        return f"it has {cells} values, but the first line has {len(columns)} names"
    if not (row["iteration"].isascii() and row["iteration"].isdigit() and len(row["iteration"]) < 16):
        return f"the iteration must be an integer, not {row['iteration']!r:.60}"
    if int(row["iteration"]) <= last:
        return f"iteration {row['iteration']} does not come after {last}"
    for name, value in row.items():
        try:
            number = float(value or "nan")
        except ValueError:
            number = LARGEST
        if LARGEST <= abs(number) < math.inf or "_" in value:
            return f"{name} must be a number, not {value!r:.60}"
    return None
