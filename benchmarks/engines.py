"""Does a policy arrive as often with the physics engine that it was not trained with?

    python benchmarks/engines.py RUN [--terrain flat] [--level 0] [--episodes 500] [--device auto] [--threads 0]

Evaluates the same policy on the same terrain and seeds with MuJoCo and with MuJoCo Warp, which must be installed. On a
GPU only Warp can run there; MuJoCo stays on the CPU.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from arrive.commands.threads import use_threads
from arrive.evaluation.arrival import cells_of, evaluate
from arrive.evaluation.policy import load_policy
from arrive.physics.device import DeviceWish, choose_device
from arrive.terrain import parse_families


@dataclass
class Arguments:
    """What to evaluate."""

    policy: tyro.conf.Positional[Path]
    terrain: str = "flat"
    level: int = 0
    episodes: int = 500
    device: DeviceWish = "auto"
    """Where Warp runs."""
    threads: int = 0


def main(arguments: Arguments) -> None:
    """Print the arrival rate with each engine."""
    threads = use_threads(arguments.threads)
    for engine, device in (("mujoco", "cpu"), ("warp", choose_device(arguments.device))):
        policy = load_policy(arguments.policy, device)
        cells = cells_of(policy.config, parse_families(arguments.terrain), arguments.level)
        config = replace(policy.config, physics=replace(policy.config.physics, engine=engine))
        results = evaluate(replace(policy, config=config), cells, arguments.episodes, seed=1, threads=threads).results
        for result in results:
            print(f"{result.cell.caption}, {engine}: {result.rate}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
