"""Scripts of stick positions, used instead of a gamepad."""

import csv
import io
import math
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arrive.deployment import Joystick
from arrive.errors import ArriveError
from arrive.fields import Range
from arrive.files import read_text

COLUMNS = ("time_s", "forward", "left", "heading_rad")
STICK = Range(-1.0, 1.0)
HEADING = Range(-2.0 * math.pi, 2.0 * math.pi)
"""Of headings [rad]. Larger ones are degrees."""
HOLD_S = (0.3, 2.0)
"""Range of the time for which a random script holds each stick position, uniform [s]."""


@dataclass(frozen=True)
class Script:
    """Stick positions. Each one applies from its time to that of the next."""

    times_s: tuple[float, ...]
    """Times in ascending order, not negative [s]."""
    sticks: tuple[Joystick, ...]

    @property
    def end_s(self) -> float:
        """Time of the last stick position [s]."""
        return self.times_s[-1]

    def stick(self, time_s: float, yaw: float) -> Joystick:
        """The stick position at a time; centred before the first one."""
        # A microsecond of tolerance, because times are sums of control steps.
        index = bisect_right(self.times_s, time_s + 1e-6) - 1
        return self.sticks[index] if index >= 0 else Joystick(0.0, 0.0)

    def close(self) -> None:
        """Do nothing: no device is open."""


def read_script(path: Path) -> Script:
    """Read a CSV file with the columns `time_s`, `forward`, `left` and `heading_rad`.

    `forward` and `left` are -1 to 1. `heading_rad` is the heading in the world to which forward refers, empty for the
    robot's own, within one turn either way. The last row ends the drive.

    Raises:
        ArriveError: the file or a column is missing, a value is no number or out of range, or times are not ascending.
    """
    text = read_text(path)
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""))
        rows, columns = list(reader), tuple(reader.fieldnames or ())
    except csv.Error as error:
        raise ArriveError(f"cannot read {path}: {error}") from error
    if columns != COLUMNS:
        raise ArriveError(f"{path} must begin with the line {','.join(COLUMNS)}, not {','.join(columns)!r}")
    if not rows:
        raise ArriveError(
            f"{path} has no stick positions: write a line per change, such as 0,1,0, and for the end 5,0,0,"
        )
    times: list[float] = []
    sticks: list[Joystick] = []
    for number, row in enumerate(rows, start=2):
        values = [_number(path, number, row[name]) for name in COLUMNS[:3]]
        heading = _number(path, number, row["heading_rad"]) if row["heading_rad"] else None
        if values[0] < (times[-1] if times else 0.0):
            raise ArriveError(f"{path}, line {number}: time goes back to {values[0]:g} s")
        for name, value in zip(COLUMNS[1:3], values[1:], strict=True):
            if not STICK.holds(value):
                raise ArriveError(f"{path}, line {number}: {name} is a stick position of -1 to 1, not {value:g}")
        if heading is not None and not HEADING.holds(heading):
            raise ArriveError(
                f"{path}, line {number}: heading_rad is -6.28 to 6.28 rad, not {heading:g}; is it in degrees?"
            )
        times.append(values[0])
        sticks.append(Joystick(values[1], values[2], heading))
    return Script(tuple(times), tuple(sticks))


def _number(path: Path, line: int, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArriveError(f"{path}, line {line}: {text!r} is not a finite number")
    return value


def random_script(seed: int, seconds: float) -> Script:
    """Stick positions uniform in direction and magnitude (a tenth of them in the dead zone), held for `HOLD_S`.

    Forward is the world's x axis.
    """
    rng = np.random.default_rng(seed)
    times, sticks, time_s = [], [], 0.0
    while time_s < seconds:
        magnitude, angle = rng.uniform(0.0, 1.0), rng.uniform(-math.pi, math.pi)
        times.append(time_s)
        sticks.append(Joystick(magnitude * math.cos(angle), magnitude * math.sin(angle), 0.0))
        time_s += rng.uniform(*HOLD_S)
    return Script((*times, seconds), (*sticks, Joystick(0.0, 0.0, 0.0)))
