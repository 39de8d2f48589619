"""Does a policy arrive as often with physics that it was not trained with?

    python benchmarks/other_physics.py fine RUN [--terrain flat] [--level 0] [--episodes 500] [--threads 0]
    python benchmarks/other_physics.py engines RUN [--device auto] ...

Evaluates the same policy on the same terrain and seeds. `fine`: with its own settings, with MuJoCo's default solver at
a physics step of 1 ms, and with MuJoCo's default contacts on top. `engines`: with MuJoCo and with MuJoCo Warp, which
must be installed. On a GPU only Warp can run there; MuJoCo stays on the CPU.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch
import tyro

from arrive.commands.threads import use_threads
from arrive.evaluation.arrival import cells_of, evaluate
from arrive.learning.policy import load_policy
from arrive.physics.device import DeviceWish, choose_device
from arrive.physics.options import PhysicsConfig
from arrive.terrain import parse_families

FINE_STEP_S = 0.001

Variant = tuple[str, PhysicsConfig, torch.device]
"""What to call it, its settings and where it runs."""


@dataclass
class Arguments:
    """What to evaluate."""

    against: tyro.conf.Positional[Literal["fine", "engines"]]
    policy: tyro.conf.Positional[Path]
    terrain: str = "flat"
    level: int = 0
    episodes: int = 500
    device: DeviceWish = "auto"
    """Where Warp runs."""
    threads: int = 0


def fine(trained: PhysicsConfig) -> Iterator[Variant]:
    """The solver that training uses, and MuJoCo's own in small steps."""
    cpu = torch.device("cpu")
    default_solver = replace(
        trained,
        timestep_s=FINE_STEP_S,
        decimation=round(trained.control_dt / FINE_STEP_S),
        solver_iterations=100,
        line_search_iterations=50,
        solver_tolerance=1e-8,
        impratio=1.0,
    )
    yield "as trained", trained, cpu
    yield "1 ms, MuJoCo's default solver", default_solver, cpu
    default_contacts = replace(default_solver, contact_time_s=0.02, contact_impedance=0.95)
    yield "1 ms, MuJoCo's default solver and contacts", default_contacts, cpu


def engines(trained: PhysicsConfig, device: DeviceWish) -> Iterator[Variant]:
    """Both physics engines."""
    yield "mujoco", replace(trained, engine="mujoco"), torch.device("cpu")
    yield "warp", replace(trained, engine="warp"), choose_device(device)


def main(arguments: Arguments) -> None:
    """Print the arrival rate with each variant."""
    threads = use_threads(arguments.threads)
    trained = load_policy(arguments.policy).config.physics
    variants = fine(trained) if arguments.against == "fine" else engines(trained, arguments.device)
    for label, physics, device in variants:
        policy = load_policy(arguments.policy, device)
        cells = cells_of(policy.config, parse_families(arguments.terrain), arguments.level)
        policy = replace(policy, config=replace(policy.config, physics=physics))
        for result in evaluate(policy, cells, arguments.episodes, seed=1, threads=threads).results:
            print(f"{result.cell.caption}, {label}: {result.rate}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
