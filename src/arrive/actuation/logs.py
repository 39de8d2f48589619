"""Logs of joints, recorded on a robot or a test bench. They are checked when they are read."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arrive.arrays import as_numbers, read_arrays
from arrive.errors import ArriveError
from arrive.files import read_text

COLUMNS = ("time", "target", "position", "velocity", "torque")
"""Seconds, radians, radians, rad/s and N m of the joint."""
JOINT = "joint"
"""Column of a CSV file with the joint's name. Without it, a file is one joint."""
LARGEST = {"target": 1e3, "position": 1e3, "velocity": 1e4, "torque": 1e5}
"""Larger values are no drive's, or are in another unit, in the units of `COLUMNS`."""
JITTER = 0.1
"""Periods may differ from their median by this share."""


@dataclass(frozen=True)
class Trajectory:
    """One joint for a while, in steps of one period."""

    name: str
    period_s: float
    target: np.ndarray
    """(steps,) [rad], as the rest."""
    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """(steps,) target minus position [rad]."""
        return self.target - self.position

    def cut(self, start: int, stop: int) -> "Trajectory":
        """The steps from `start` to before `stop`."""
        parts = (getattr(self, name)[start:stop] for name in COLUMNS[1:])
        return Trajectory(f"{self.name}[{start}:{stop}]", self.period_s, *parts)


def read_logs(paths: Sequence[Path], period_s: float) -> list[Trajectory]:
    """Every joint of every file, in steps of `period_s`.

    Args:
        paths: CSV files with a header, or NPZ files, with `COLUMNS`; a CSV file may have `JOINT`, and an NPZ file's
            arrays but the time may have one column per joint.
        period_s: physics step of the simulation; the logs' period must divide it [s].

    Raises:
        ArriveError: a file that cannot be read, a missing column, a value that is no number, a period that is
            irregular or does not divide `period_s`. The message names file, row and column.
    """
    trajectories = []
    for path in paths:
        for name, columns in (_read_npz if path.suffix == ".npz" else _read_csv)(path).items():
            trajectories.append(_trajectory(path, name, columns, period_s))
    return trajectories


@dataclass(frozen=True)
class _Columns:
    """(rows,) values of each column, and the row of the file that each is from."""

    values: dict[str, np.ndarray]
    rows: np.ndarray


def _read_csv(path: Path) -> dict[str, _Columns]:
    """Columns per joint; rows are counted as an editor counts lines, the header being the first."""
    try:
        reader = iter(list(csv.reader(io.StringIO(read_text(path, "utf-8-sig")))))
    except csv.Error as error:
        raise ArriveError(f"cannot read {path}: {error}") from error
    header = [name.strip() for name in next(reader, [])]
    _need_columns(path, header)
    places = {name: header.index(name) for name in COLUMNS}
    joints: dict[str, list[list[float]]] = {}
    for row, cells in enumerate(reader, start=2):
        if not cells:
            continue
        if len(cells) != len(header):
            raise ArriveError(f"{path}, row {row}: {len(cells)} values where the header has {len(header)} columns")
        joint = cells[header.index(JOINT)].strip() if JOINT in header else ""
        values = [_number(path, row, name, cells[place]) for name, place in places.items()]
        joints.setdefault(joint, []).append([row, *values])
    if not joints:
        raise ArriveError(f"{path}: no rows below the header")
    tables = {joint: np.array(rows) for joint, rows in joints.items()}
    return {
        joint: _Columns(dict(zip(COLUMNS, table[:, 1:].T, strict=True)), table[:, 0].astype(int))
        for joint, table in tables.items()
    }


def _read_npz(path: Path) -> dict[str, _Columns]:
    """Columns per joint; rows are indices, the first being 0."""
    found = read_arrays(path)
    arrays = {name: as_numbers(path, name, found[name], np.float64) for name in COLUMNS if name in found}
    _need_columns(path, list(arrays))
    time = arrays.pop("time")
    shape = arrays["target"].shape
    if time.ndim != 1 or len(shape) not in (1, 2) or shape[:1] != time.shape:
        raise ArriveError(f"{path}: time must be (steps,) and the rest (steps,) or (steps, joints), not {shape}")
    for name, array in arrays.items():
        if array.shape != shape:
            raise ArriveError(f"{path}: column {name} is {array.shape}, where target is {shape}")
    if not time.size or not arrays["target"].size:
        raise ArriveError(f"{path}: its columns are empty")
    tables = {name: array.reshape(len(time), -1) for name, array in arrays.items()}
    rows = np.arange(len(time))
    for name, table in (("time", time[:, None]), *tables.items()):
        for row, joint in np.argwhere(~np.isfinite(table))[:1]:
            raise ArriveError(f"{path}, row {row}, column {name}: {table[row, joint]} is no finite number")
    return {
        str(joint): _Columns({"time": time} | {name: table[:, joint] for name, table in tables.items()}, rows)
        for joint in range(tables["target"].shape[1])
    }


def _need_columns(path: Path, names: list[str]) -> None:
    repeated = [name for name in COLUMNS if names.count(name) > 1]
    if repeated:
        raise ArriveError(f"{path}: more than one column {', '.join(repeated)}")
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise ArriveError(f"{path}: no column {', '.join(missing)}; it has {', '.join(names)[:200] or 'none'}")


def _number(path: Path, row: int, name: str, text: str) -> float:
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArriveError(f"{path}, row {row}, column {name}: {text.strip()!r:.60} is no finite number")
    return value


def _trajectory(path: Path, joint: str, columns: _Columns, period_s: float) -> Trajectory:
    """Every so many samples of a joint, after a look at its clock."""
    name = f"{path}:{joint}" if joint else str(path)
    every = _every(path, columns, period_s)
    for column, most in LARGEST.items():
        wrong = np.flatnonzero(np.abs(columns.values[column]) > most)
        if len(wrong):
            row, value = columns.rows[wrong[0]], columns.values[column][wrong[0]]
            raise ArriveError(
                f"{path}, row {row}, column {column}: {value:g} is beyond {most:g}: is it in another unit?"
            )
    parts = (columns.values[column][::every] for column in COLUMNS[1:])
    return Trajectory(name, period_s, *parts)


def _every(path: Path, columns: _Columns, period_s: float) -> int:
    """How many of the log's periods make one of `period_s`."""
    gaps = np.diff(columns.values["time"])
    if not len(gaps):
        raise ArriveError(f"{path}: a single row is no log")
    period = float(np.median(gaps))
    bad = np.flatnonzero(np.abs(gaps - period) > JITTER * abs(period))
    if period <= 0.0 or len(bad):
        at = int(bad[0]) if len(bad) else 0
        raise ArriveError(
            f"{path}, row {columns.rows[at + 1]}, column time: {gaps[at]:.6g} s after the row before, where "
            f"the period is {period:.6g} s; record at a constant rate, or cut the log there"
        )
    mean = float(gaps.mean())
    every = round(period_s / mean)
    if every < 1 or abs(every * mean / period_s - 1.0) > 0.01:
        raise ArriveError(
            f"{path}, column time: the period of {mean:.6g} s does not divide the {period_s:g} s that are wanted; "
            "choose another --period-s"
        )
    return every
