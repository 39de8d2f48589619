"""The status line of `arrive drive`."""

import math
import sys

from arrive.drive.session import DriveSample, DriveStatistics

LIVE_S, PLAIN_S = 0.1, 5.0
"""Simulated time between lines: on a terminal, where each line replaces the last one, and in a file [s]."""
ARROWS = "↑↖←↙↓↘→↗"
"""Directions relative to the heading, counter-clockwise from straight ahead."""


class StatusLine:
    """Prints the state of a drive at intervals."""

    def __init__(self) -> None:
        """Write to standard output."""
        self._live = sys.stdout.isatty()
        self._next_s = 0.0

    def report(self, sample: DriveSample, statistics: DriveStatistics) -> None:
        """Add a step, and print it if it is time."""
        if sample.time_s < self._next_s and not sample.fell:
            return
        self._next_s = sample.time_s + (LIVE_S if self._live else PLAIN_S)
        start, end = ("\r\x1b[K", "") if self._live else ("", "\n")
        print(start + drive_status(sample, statistics), end=end, flush=True)

    def close(self) -> None:
        """Keep the last line on the terminal."""
        if self._live:
            print()


def drive_status(sample: DriveSample, statistics: DriveStatistics) -> str:
    """One step as a line. The arrow shows the commanded direction relative to the robot's heading."""
    asked = "stop"
    if sample.commanded_speed:
        relative = sample.commanded_angle - sample.yaw
        arrow = ARROWS[round(relative / (math.pi / 4)) % 8]
        asked = f"{arrow} {sample.commanded_speed:.2f} m/s"
    speed = math.hypot(*sample.velocity_w)
    reached = f"{sample.along:+.2f} m/s along, {speed:.2f} in all" if sample.commanded_speed else f"{speed:.2f} m/s"
    return f"{sample.time_s:7.1f} s  {sample.mode:8}  asked {asked:10}  walks {reached}  falls {statistics.falls}"


def summarise(statistics: DriveStatistics) -> str:
    """The whole drive as a line."""
    words = f"{statistics.time_s:.1f} s, {statistics.falls} falls"
    if statistics.driven_s:
        asked, along = statistics.commanded_m / statistics.driven_s, statistics.along_m / statistics.driven_s
        words += f"; commanded {asked:.2f} m/s on average, achieved {along:.2f} m/s along the command"
    if statistics.late_s:
        words += f"; the machine was too slow for real time and lost {statistics.late_s:.1f} s"
    return words
