"""How long until a policy arrives: trains several seeds one after the other and reads their logs.

    python benchmarks/learning.py flat --minutes 10 --seeds 1 2 3 --out runs/learning
    python benchmarks/learning.py gap --minutes 60 --goal-level 5

Prints, per seed, when the arrival rate of training first reached the goal (or the mean level did), and the arrival rate
of the final policy over the given number of evaluation episodes.
"""

import csv
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass
class Arguments:
    """What to train, and what counts as learnt."""

    terrain: tyro.conf.Positional[str]
    minutes: float = 10.0
    seeds: tuple[int, ...] = (1, 2, 3)
    threads: int = 0
    goal_arrival: float = 0.9
    """Arrival rate during training, with exploration noise."""
    goal_level: float | None = None
    """Mean terrain level, instead."""
    level: int = 0
    """Level of the final evaluation."""
    episodes: int = 1000
    out: Path = Path("runs/learning")


def arrive(*arguments: object) -> None:
    """Run the command line."""
    subprocess.run([sys.executable, "-m", "arrive.cli", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def reached(folder: Path, column: str, goal: float) -> tuple[float, float] | None:
    """Minutes and million samples after which a logged figure first reached the goal."""
    with (folder / "log.csv").open() as file:
        for row in csv.DictReader(file):
            if row[column] and float(row[column]) >= goal:
                return float(row["progress/elapsed_s"]) / 60.0, float(row["progress/samples"]) / 1e6
    return None


def main(arguments: Arguments) -> None:
    """Train, evaluate and print a table in Markdown."""
    column = "arrival/all" if arguments.goal_level is None else f"level/{arguments.terrain}"
    goal = arguments.goal_arrival if arguments.goal_level is None else arguments.goal_level
    print(f"| seed | {column} {goal:g} after | samples | final arrival of {arguments.episodes} | interval |")
    print("|---|---|---|---|---|")
    for seed in arguments.seeds:
        folder = arguments.out / f"{arguments.terrain}-{seed}"
        threads = ("--threads", arguments.threads)
        arrive("train", arguments.terrain, "--minutes", arguments.minutes, "--seed", seed, "--out", folder, *threads)
        result = folder / "arrival.json"
        level = ("--level", arguments.level)
        arrive("eval", folder, *level, "--episodes", arguments.episodes, "--json", result, *threads)
        row = next(iter(json.loads(result.read_text())["families"].values()))["levels"][0]
        when = reached(folder, column, goal)
        after = f"{when[0]:.1f} min | {when[1]:.2f} M" if when else "not reached | "
        low, high = row["interval"]
        print(f"| {seed} | {after} | {row['success']:.1%} | {low:.1%} to {high:.1%} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
