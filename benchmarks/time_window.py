"""Trains with several lengths of the reward window T_r, from half a second to the whole episode, and compares.

    python benchmarks/time_window.py gap=0.2 --samples 1e7
    python benchmarks/time_window.py stairs=0.1 --windows 0.5 2 8 --seeds 1 2 --samples 2e7 --threads 1

With T_r = T the task is P_c. All episodes have the preset's longest time, so that every window fits. The results are
success, arrival time, path and speed by the protocol of maximum difficulty, and the cost of walking on flat ground. The
same command continues an interrupted benchmark, and more windows or seeds are added to it. time_window.json has the
results so far and is enough to continue from; `arrive report --window` shows it.
"""

from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import torch
import tyro
from trainings import Results, Training, command, markdown

from arrive.config import override
from arrive.evaluation.energy import measure_energy
from arrive.learning.rundir import commit
from arrive.presets import get_preset


@dataclass
class Arguments:
    """Trainings and measurements."""

    ground: tyro.conf.Positional[str] = "gap=0.2"
    """Terrain family to train on, with the value to measure at."""
    windows: tuple[float, ...] = ()
    """T_r [s]; 0.5, 1, 2, 4 and the preset's whole episode by default."""
    samples: float = 1e7
    """Policy steps of every run."""
    seeds: tuple[int, ...] = (1,)
    preset: str = "robust"
    episodes: int = 200
    speeds: tuple[float, ...] = (0.5, 0.75, 1.0)
    """Commanded speeds for the cost of walking [m/s]."""
    robots: int = 20
    """Robots per speed."""
    distance: float = 20.0
    """Distance that each robot walks [m]."""
    threads: int = 0
    set: tuple[str, ...] = ()
    """Settings of all runs, as PATH=VALUE."""
    out: Path = Path("runs/time_window")


def main(arguments: Arguments) -> None:
    """Train and measure the missing runs, one after the other, and print the table."""
    torch.set_num_threads(1)
    episode_s = override(get_preset(arguments.preset), arguments.set).task.episode_s
    windows = arguments.windows or (*(w for w in (0.5, 1.0, 2.0, 4.0) if w < episode_s), episode_s)
    if max(windows) > episode_s:
        raise SystemExit(f"--windows must be at most the episode of {episode_s:g} s, not {max(windows):g}")
    results = Results(
        arguments.out / "time_window.json",
        partial(content, arguments, episode_s),
        names=("seed", "window_s"),
        extended=("seeds",),
    )
    for run in results.complete(product(arguments.seeds, windows), partial(run_of, arguments, episode_s)):
        print(f"T_r {run['window_s']:g} s, seed {run['seed']}: {run['success']:.1%}", flush=True)
    print(table(results.runs()))


def run_of(arguments: Arguments, episode_s: float, seed: int, window: float) -> dict[str, Any]:
    """Train and measure one run. Times and paths are quartiles, or None if no robot arrived."""
    folder = arguments.out / f"{arguments.ground}-{window:g}-{seed}".replace("=", "-")
    settings = (*arguments.set, f"task.episode_min_s={episode_s}", f"task.reward_window_s={window}")
    training = Training(
        folder, arguments.ground, seed, arguments.samples, arguments.preset, settings, arguments.threads
    )
    policy = training.finish()
    measured = training.measure(policy, arguments.episodes)
    costs = measure_energy(policy, arguments.speeds, arguments.robots, arguments.distance, 1, arguments.threads)
    usage = {key: measured["usage"].get(key) for key in ("arrival_time_s", "path_length_m", "speed_profile", "motion")}
    own = {"window_s": window, "seed": seed, "samples": policy.samples, "commit": policy.commit}
    return own | {"energy": costs["speeds"]} | {key: measured[key] for key in ("success", "interval")} | usage


def content(arguments: Arguments, episode_s: float, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """All results so far as JSON data."""
    return {
        "runs": sorted(runs, key=lambda run: (run["seed"], run["window_s"])),
        "protocol": {
            "name": "time_window",
            "preset": arguments.preset,
            "ground": arguments.ground,
            "samples": arguments.samples,
            "episodes": arguments.episodes,
            "episode_s": episode_s,
            "seeds": sorted({run["seed"] for run in runs}),
            "set": list(arguments.set),
            "energy": {
                "speeds": list(arguments.speeds),
                "robots": arguments.robots,
                "distance_m": arguments.distance,
            },
        },
        "command": command(),
        "commit": commit(),
    }


def table(runs: list[dict[str, Any]]) -> str:
    """A row per run."""
    rows = []
    for run in runs:
        low, high = run["interval"]
        times, paths = (f"{run[key][1]:.2f}" if run[key] else "-" for key in ("arrival_time_s", "path_length_m"))
        costs = ", ".join(
            f"{row['torque_sq'][0]:.0f} at {row['speed'][0]:.2f} m/s" for row in run["energy"] if row["torque_sq"]
        )
        success = f"{run['success']:.1%} ({low:.1%} to {high:.1%})"
        rows.append([f"{run['window_s']:g}", str(run["seed"]), success, times, paths, costs or "no robot walked"])
    return markdown(["T_r [s]", "seed", "success", "time [s]", "path [m]", "squared torques per metre"], rows)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
