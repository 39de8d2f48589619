"""Does a policy arrive as often with physics and motors that it was not trained with?

    python benchmarks/other_physics.py POLICY [--terrain gap=0.2,flat] [--variants fine steps] [--episodes 500]
    python benchmarks/other_physics.py POLICY --variants network --network drive.safetensors

Evaluates the same policy by the protocol of maximum difficulty, on the same terrain and seeds, with

- `contacts`: legs that pass through each other;
- `fine`: physics steps of 1 ms, with MuJoCo's default solver, and with its default contacts on top;
- `steps`: physics steps of 6.67 and 10 ms, three and two per policy step;
- `motor`: PD with the effort limit alone;
- `network`: the actuator network in `--network`, with each clip;
- `engines`: MuJoCo Warp, which must be installed. On a GPU only Warp can run there; MuJoCo stays on the CPU.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch
import tyro

from arrive.commands.threads import use_threads
from arrive.evaluation.arrival import choose_cells
from arrive.evaluation.difficulty import measure_difficulty
from arrive.files import write_json
from arrive.learning.policy import load_policy
from arrive.physics.device import DeviceWish, choose_device
from arrive.physics.options import PhysicsConfig, with_decimation

FINE_STEP_S = 0.001
LONG_STEPS = (3, 2)
"""Physics steps per policy step of `steps`."""

Group = Literal["contacts", "fine", "steps", "motor", "network", "engines"]
Variant = tuple[str, PhysicsConfig, torch.device]
"""What to call it, its settings and where it runs."""


@dataclass
class Arguments:
    """What to evaluate."""

    policy: tyro.conf.Positional[Path]
    terrain: str = "flat"
    """Families joined by commas, each with the value to measure at: NAME=VALUE."""
    variants: tuple[Group, ...] = ("contacts", "fine", "steps", "motor")
    network: Path | None = None
    """Actuator network, as `arrive actuator import` or `fit` writes it."""
    episodes: int = 500
    seed: int = 1
    device: DeviceWish = "auto"
    """Where Warp runs."""
    threads: int = 0
    json: Path | None = None
    """File for the results."""


def variants(trained: PhysicsConfig, arguments: Arguments) -> Iterator[Variant]:
    """Everything that is measured, beginning with the policy's own physics."""
    cpu = torch.device("cpu")
    yield "as trained", trained, cpu
    for group in arguments.variants:
        if group == "contacts":
            yield "legs pass through each other", replace(trained, leg_contacts=False), cpu
        elif group == "fine":
            for label, physics in fine(trained):
                yield label, physics, cpu
        elif group == "steps":
            for decimation in LONG_STEPS:
                physics = with_decimation(trained, decimation)
                yield f"{1e3 * physics.timestep_s:.3g} ms x {decimation}", physics, cpu
        elif group == "motor":
            yield "PD with the effort limit alone", replace(trained, motor="ideal"), cpu
        elif group == "network":
            if arguments.network is None:
                raise SystemExit("--variants network needs --network FILE")
            own = replace(trained, motor="network", motor_file=str(arguments.network.resolve()))
            yield "actuator network, affine clip", own, cpu
            yield "actuator network, constant clip", replace(own, motor_clip="constant"), cpu
        else:
            yield "MuJoCo Warp", replace(trained, engine="warp"), choose_device(arguments.device)


def fine(trained: PhysicsConfig) -> Iterator[tuple[str, PhysicsConfig]]:
    """MuJoCo's own solver in small steps, then its own contacts too."""
    default_solver = replace(
        trained,
        timestep_s=FINE_STEP_S,
        decimation=round(trained.control_dt / FINE_STEP_S),
        solver_iterations=100,
        line_search_iterations=50,
        solver_tolerance=1e-8,
        impratio=1.0,
    )
    yield "1 ms, MuJoCo's default solver", default_solver
    yield (
        "1 ms, MuJoCo's default solver and contacts",
        replace(default_solver, contact_time_s=0.02, contact_impedance=0.95),
    )


def main(arguments: Arguments) -> None:
    """Print the success rate with each variant."""
    threads = use_threads(arguments.threads)
    trained = load_policy(arguments.policy).config
    grounds = choose_cells(trained, arguments.terrain)
    families = [family for family, _ in grounds]
    chosen = {family.name: cell for family, cell in grounds if cell is not None}
    rows = []
    for label, physics, device in variants(trained.physics, arguments):
        policy = load_policy(arguments.policy, device)
        policy = replace(policy, config=replace(policy.config, physics=physics))
        found = measure_difficulty(policy, families, arguments.episodes, arguments.seed, threads=threads, chosen=chosen)
        for name, results in found.results.items():
            for result in results:
                print(f"{name} {result.cell.value}, {label}: {result.rate}", flush=True)
                rows.append({"terrain": name, "physics": label} | result.content())
        if arguments.json is not None:
            write_json(arguments.json, {"policy": str(arguments.policy), "seed": arguments.seed, "rows": rows})


if __name__ == "__main__":
    main(tyro.cli(Arguments))
