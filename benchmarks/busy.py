"""Measures training throughput beside busy processes, with the default threads and with one thread.

    python benchmarks/busy.py [--num-envs 256] [--neighbours 1] [--rounds 5] [--out busy.json]

Every round runs `arrive bench` four times, each in a process of its own: with the default threads and with --threads 1,
both alone and beside busy processes. A disturbance of the machine then affects all four. Before each run the number of
CPUs that other processes keep busy is measured. The results of "alone" are only valid if it is near 0.
"""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from trainings import bench, markdown

from arrive.files import write_json
from arrive.learning.rundir import commit
from arrive.neighbours import busy_cpus

RATE = "train_samples_per_s"
THREADS = {"default": (), "one": ("--threads", "1")}
"""Arguments of `arrive bench` by name."""


@dataclass
class Arguments:
    """What to measure."""

    terrain: tyro.conf.Positional[str] = "flat"
    num_envs: int = 256
    neighbours: int = 1
    """Number of busy processes beside the training."""
    rounds: int = 5
    set: tuple[str, ...] = ()
    """Changes to the configuration, as for `arrive bench`."""
    out: Path = Path("busy.json")


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Run this number of processes, each of which keeps a CPU busy."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def measure(arguments: Arguments, threads: str) -> dict[str, float]:
    """Run `arrive bench` once: training throughput [samples/s], and the number of CPUs that were busy before it."""
    others = busy_cpus()
    options = ["--rounds", "1", "--num-envs", str(arguments.num_envs), *THREADS[threads]]
    options += ["--set", *arguments.set] if arguments.set else []
    return {"rate": bench(arguments.terrain, *options)[RATE], "busy_cpus": others}


def summary(rounds: list[dict[str, float]]) -> dict[str, Any]:
    """Median, lowest and highest throughput [samples/s], and the highest number of busy CPUs."""
    rates = [row["rate"] for row in rounds]
    others = max(row["busy_cpus"] for row in rounds)
    return {"median": median(rates), "least": min(rates), "most": max(rates), "busy_cpus": others, "rates": rates}


def main(arguments: Arguments) -> None:
    """Print a table in Markdown and write the results."""
    cases = {(place, threads): [] for place in ("alone", "busy") for threads in THREADS}
    for _ in range(arguments.rounds):
        for place, threads in cases:
            with busy(arguments.neighbours if place == "busy" else 0):
                cases[place, threads].append(measure(arguments, threads))
    results = {f"{place}, {threads}": summary(rounds) for (place, threads), rounds in cases.items()}
    rows = []
    for (place, threads), result in zip(cases, results.values(), strict=True):
        count = arguments.neighbours if place == "busy" else 0
        rates = f"{result['median']:,.0f}", f"{result['least']:,.0f} to {result['most']:,.0f}"
        rows.append([str(count), threads, *rates, f"{result['busy_cpus']:.2f}"])
    print(markdown(["neighbours", "threads", "median [samples/s]", "least to most", "CPUs busy before it"], rows))
    for place in ("alone", "busy"):
        ratio = results[f"{place}, one"]["median"] / results[f"{place}, default"]["median"]
        print(f"{place}: with the default threads training takes {ratio:.2f} times as long as with one thread")
    settings = {key: value for key, value in vars(arguments).items() if key != "out"}
    write_json(arguments.out, {"results": results, "settings": settings, "commit": commit()})


if __name__ == "__main__":
    main(tyro.cli(Arguments))
