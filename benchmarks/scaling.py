"""Measures throughput for several numbers of environments and threads.

    python benchmarks/scaling.py [--num-envs 256 512 1024 2048 4096] [--threads 1 2] [--rounds 5] [--out scaling.json]

Each combination runs `arrive bench` in a process of its own, one after the other. The number of steps per iteration is
chosen so that all have the same number of samples per iteration.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import tyro
from trainings import bench


@dataclass
class Arguments:
    """Sizes and rounds."""

    terrain: tyro.conf.Positional[str] = "flat"
    num_envs: tuple[int, ...] = (256, 512, 1024, 2048, 4096)
    threads: tuple[int, ...] = (1, 2)
    rounds: int = 5
    start_from: Path | None = None
    samples: int = 12288
    """Samples per iteration."""
    out: Path = Path("scaling.json")


def measure(arguments: Arguments, num_envs: int, threads: int) -> dict:
    """Run `arrive bench` once."""
    options = ["--num-envs", str(num_envs), "--threads", str(threads), "--rounds", str(arguments.rounds)]
    options += ["--set", f"ppo.num_steps={max(1, arguments.samples // num_envs)}"]
    if arguments.start_from is not None:
        options += ["--start-from", str(arguments.start_from)]
    return bench(arguments.terrain, *options)


def main(arguments: Arguments) -> None:
    """Print a table in Markdown and write the results."""
    results = []
    print("| environments | threads | engine | environment | over engine | collection | update | training |")
    print("|---|---|---|---|---|---|---|---|")
    for num_envs in arguments.num_envs:
        for threads in arguments.threads:
            result = measure(arguments, num_envs, threads)
            results.append(result)
            rates = ("engine", "env", "collect", "update_samples_per_s", "train_samples_per_s")
            engine, env, collect, update, train = (f"{result[name]:,.0f}" for name in rates)
            ratio = f"{result['env_over_engine']:.2f}"
            print(
                f"| {num_envs} | {threads} | {engine} | {env} | {ratio} | {collect} | {update} | {train} |", flush=True
            )
            arguments.out.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
