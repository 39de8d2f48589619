"""Trains terrain families from scratch with several seeds, and measures each policy by the protocol.

    python benchmarks/from_scratch.py gap pit --seeds 1 2 3 --samples 30M
    python benchmarks/from_scratch.py gap --set ppo.gamma=0.99 --out runs/gamma

The same command continues an interrupted run. For each run, OUT/table.md and OUT/table.json have the solved values, the
numbers of samples after which the mean terrain level reached 1, 2 and so on, and the duration.
"""

import csv
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from trainings import arrive, markdown

from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.policies import DIFFICULTY_NAME


@dataclass
class Arguments:
    """Training and measurement."""

    terrains: tyro.conf.Positional[tuple[str, ...]]
    """Terrain families; several joined by commas make one policy."""
    seeds: tuple[int, ...] = (1, 2, 3)
    samples: str = "30M"
    """Policy steps per run."""
    set: tuple[str, ...] = ()
    """Changes to the configuration, as PATH=VALUE, for experiments."""
    processes: int = 2
    """Number of parallel runs, with one thread each."""
    episodes: int = 500
    """Episodes per level in the measurement."""
    out: Path = Path("runs/from_scratch")


@dataclass(frozen=True)
class Run:
    """One policy to train."""

    terrain: str
    seed: int
    folder: Path


def main(arguments: Arguments) -> None:
    """Train and measure the missing runs, then write the tables."""
    runs = [
        Run(name, seed, arguments.out / f"{name}-{seed}") for name in arguments.terrains for seed in arguments.seeds
    ]
    with ThreadPoolExecutor(arguments.processes) as pool:
        rows = list(pool.map(lambda run: make(run, arguments), runs))
    (arguments.out / "table.json").write_text(json.dumps({"arguments": vars(arguments), "runs": rows}, default=str))
    (arguments.out / "table.md").write_text(table(rows))
    print(table(rows))


def make(run: Run, arguments: Arguments) -> dict[str, Any]:
    """Train and measure one policy; returns its results."""
    if (run.folder / CHECKPOINT_NAME).exists():
        words = ("--resume", str(run.folder))
    else:
        changes = ("--set", *arguments.set) if arguments.set else ()
        words = ("--seed", str(run.seed), "--out", str(run.folder), *changes)
    arrive("train", run.terrain, "--samples", arguments.samples, "--threads", "1", *words)
    measured = run.folder / DIFFICULTY_NAME
    if not measured.exists():
        options = ("--episodes", str(arguments.episodes), "--threads", "1", "--json", str(measured))
        arrive("eval", str(run.folder), "--protocol", "difficulty", *options)
    return summary(run, json.loads(measured.read_text()))


def summary(run: Run, measured: dict[str, Any]) -> dict[str, Any]:
    """The results of a run, from its log and its measurement."""
    with (run.folder / "log.csv").open() as file:
        log = list(csv.DictReader(file))
    families = measured["families"]
    return {
        "terrain": run.terrain,
        "seed": run.seed,
        "samples": float(log[-1]["progress/samples"]),
        "minutes": float(log[-1]["progress/elapsed_s"]) / 60.0,
        "samples_to_level": {name: climb(log, f"level/{name}") for name in families if f"level/{name}" in log[0]},
        "solved": {name: family["max_at_95"] for name, family in families.items()},
        "success": {name: {row["value"]: row["success"] for row in f["levels"]} for name, f in families.items()},
    }


def climb(log: list[dict[str, str]], column: str) -> list[float]:
    """Samples after which the mean level first reached 1, 2, 3 and so on."""
    reached: list[float] = []
    for row in log:
        while row[column] and float(row[column]) >= len(reached) + 1:
            reached.append(float(row["progress/samples"]))
    return reached


def table(rows: list[dict[str, Any]]) -> str:
    """One line per run and family, in Markdown."""
    lines = []
    for row in rows:
        for name, success in row["success"].items():
            rates = ", ".join(f"{value:g}: {rate:.1%}" for value, rate in success.items())
            budget = f"{row['samples'] / 1e6:.1f} M", f"{row['minutes']:.0f}"
            solved = "-" if row["solved"][name] is None else f"{row['solved'][name]:g}"
            lines.append([row["terrain"], str(row["seed"]), *budget, name, solved, rates])
    head = ["trained on", "seed", "samples", "minutes", "measured on", "solved with 95 %", "success"]
    return markdown(head, lines) + "\n"


if __name__ == "__main__":
    main(tyro.cli(Arguments))
