"""Measures how well a policy follows a joystick: commanded and achieved speed, and falls in a random drive.

    python benchmarks/joystick.py [POLICY] [--picture docs/images/joystick.png] [--table joystick.md]

POLICY is a run folder, a policy file, an exported file or the name of a shipped policy. Speeds are measured on flat
ground with friction 1, without noise, pushes or payload. Robots start standing and walk in eight directions relative to
their first heading. The direction is fixed in the world, even if the robot turns. The result is the mean velocity in
the commanded direction from 2 s to 8 s.
"""

import argparse
import math
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from arrive.config import Config, saved_config
from arrive.deployment import Controller, Joystick
from arrive.deployment.goals import DEAD_ZONE
from arrive.deployment.opening import open_policy
from arrive.deployment.policy_file import PolicyFile
from arrive.drive.driver import Driver
from arrive.drive.script import random_script
from arrive.drive.session import DriveSample, DriveStatistics, advance, run
from arrive.errors import ArriveError
from arrive.simulation import SimulatedRobot, continued
from arrive.terrain.ground import ground_of

DIRECTIONS = 8
SPEEDS = 5
"""Number of commanded speeds."""
RUN_UP_S, MEASURED_S = 2.0, 6.0
HECTIC_S = 300.0


@dataclass(frozen=True)
class Walk:
    """One command from one start."""

    commanded: float
    """[m/s]."""
    direction: float
    """Relative to the heading at the start [rad]."""
    along: float
    """Mean velocity in the commanded direction [m/s]."""
    across: float
    """Mean velocity to the left of it [m/s]."""
    fell: bool


def sticks(policy: PolicyFile) -> list[float]:
    """Stick magnitudes for evenly spaced speeds."""
    if policy.task.name == "continuous":
        return np.linspace(1.0 / SPEEDS, 1.0, SPEEDS).tolist()
    # The slowest command is just outside the dead zone.
    return np.linspace(DEAD_ZONE + 1e-9, 1.0, SPEEDS).tolist()


def walk(policy: PolicyFile, robot: SimulatedRobot, magnitude: float, direction: float, yaw: float) -> Walk:
    """Hold one stick position and measure the velocity."""
    driver = Driver(robot, Controller(policy))
    robot.reset(yaw=yaw)
    stick = Joystick(magnitude * math.cos(direction), magnitude * math.sin(direction), yaw)
    samples: list[DriveSample] = []
    for _ in range(round((RUN_UP_S + MEASURED_S) / robot.control_dt)):
        samples.append(advance(driver, stick))
        if samples[-1].fell:
            break
    measured = [sample for sample in samples if sample.time_s > RUN_UP_S + 1e-6] or samples[-1:]
    along = np.mean([sample.along for sample in measured])
    angle = samples[0].commanded_angle
    across = np.mean([sample.velocity_w @ (-math.sin(angle), math.cos(angle)) for sample in measured])
    return Walk(samples[0].commanded_speed, direction, float(along), float(across), samples[-1].fell)


def measure(policy: PolicyFile, repeats: int) -> list[Walk]:
    """Every speed in every direction, each from `repeats` headings."""
    robot = flat_robot(policy)
    yaws = np.random.default_rng(1).uniform(-math.pi, math.pi, repeats)
    directions = np.arange(DIRECTIONS) * 2.0 * math.pi / DIRECTIONS
    return [walk(policy, robot, *case) for case in product(sticks(policy), directions, yaws)]


def flat_robot(policy: PolicyFile) -> SimulatedRobot:
    """A robot on unlimited flat ground."""
    config: Config = saved_config(policy.meta["training"]["config"], policy.path)
    return SimulatedRobot(config, continued(ground_of("flat").build()))


def hectic(policy: PolicyFile, seed: int) -> DriveStatistics:
    """Drive for five minutes with random stick positions that change every 0.3 to 2 s."""
    driver = Driver(flat_robot(policy), Controller(policy))
    return run(driver, random_script(seed, HECTIC_S), HECTIC_S, lambda sample, statistics: None, real_time=False)


def table(walks: list[Walk]) -> str:
    """Mean achieved speed by commanded speed and direction, as Markdown."""
    angles = sorted({w.direction for w in walks})
    head = ["commanded [m/s]", *(f"{math.degrees(a):.0f}°" for a in angles), "mean", "drift", "falls"]
    lines = [" | ".join(head), " | ".join(["---"] * len(head))]
    for speed in sorted({w.commanded for w in walks}):
        same = [w for w in walks if w.commanded == speed]
        cells = [f"{np.mean([w.along for w in same if w.direction == a]):.2f}" for a in angles]
        mean, drift = np.mean([w.along for w in same]), np.mean([abs(w.across) for w in same])
        falls = f"{sum(w.fell for w in same)} of {len(same)}"
        lines.append(" | ".join([f"{speed:.2f}", *cells, f"**{mean:.2f}**", f"{drift:.2f}", falls]))
    return "\n".join(f"| {line} |" for line in lines)


def plot(walks: list[Walk], name: str, task_speeds: tuple[float, float], path: Path) -> None:
    """Commanded against achieved speed, one line per direction."""
    figure, axes = plt.subplots(figsize=(6.4, 4.8), constrained_layout=True)
    speeds = sorted({w.commanded for w in walks})
    for k, angle in enumerate(sorted({w.direction for w in walks})):
        means = [np.mean([w.along for w in walks if w.commanded == s and w.direction == angle]) for s in speeds]
        colour = plt.get_cmap("twilight")(0.1 + 0.8 * k / DIRECTIONS)
        axes.plot(speeds, means, "o-", color=colour, label=f"{math.degrees(angle):.0f}°")
    axes.plot(task_speeds, task_speeds, "k--", label="as commanded")
    axes.set(xlabel="commanded: 3 m / remaining time [m/s]", ylabel="achieved along the command [m/s]", title=name)
    axes.set_ylim(bottom=0.0)
    axes.legend(title="direction from the\nstarting heading", ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", nargs="?")
    parser.add_argument("--picture", type=Path, default=Path("docs/images/joystick.png"))
    parser.add_argument("--table", type=Path, help="file for the table, which is always printed")
    parser.add_argument("--repeats", type=int, default=5, help="starting headings per command")
    parser.add_argument("--drives", type=int, default=3, help="random drives of five minutes, with seeds 1, 2, ...")
    arguments = parser.parse_args()
    policy = open_policy(arguments.policy)
    name = arguments.policy or "shipped policy"
    walks = measure(policy, arguments.repeats)
    text = table(walks)
    runs = [hectic(policy, seed) for seed in range(1, arguments.drives + 1)]
    if runs:
        falls = ", ".join(str(statistics.falls) for statistics in runs)
        driven = sum(statistics.driven_s for statistics in runs)
        asked, along = (sum(getattr(t, what) for t in runs) / driven for what in ("commanded_m", "along_m"))
        text += (
            f"\n\n{len(runs)} drives of {HECTIC_S:.0f} s with a new stick every 0.3 to 2 s (seeds 1 to {len(runs)}): "
            f"{falls} falls; commanded {asked:.2f} m/s on average, achieved {along:.2f} m/s along the command."
        )
    print(text)
    if arguments.table:
        arguments.table.write_text(text + "\n")
    plot(walks, name, (0.0, max(w.commanded for w in walks)), arguments.picture)
    print(f"picture: {arguments.picture}")


if __name__ == "__main__":
    try:
        main()
    except ArriveError as error:
        raise SystemExit(f"joystick: {error}") from None
