"""Compares the success rate of a policy with its own physics, and with other physics, motors and another base.

    python benchmarks/other_physics.py POLICY [--terrain gap=0.2,flat] [--variants fine steps] [--episodes 500]
    python benchmarks/other_physics.py POLICY --variants network --network drive.safetensors

Evaluates the same policy by the protocol of maximum difficulty, on the same terrain and seeds, with

- `contacts`: legs that pass through each other;
- `fine`: physics steps of 1 ms, with MuJoCo's default solver, and with its default contacts on top;
- `steps`: physics steps of 6.67 and 10 ms, three and two per policy step;
- `motor`: PD with the effort limit alone;
- `network`: the actuator network in `--network`, with each clip;
- `base`: ANYmal C with the base of MuJoCo Menagerie's, 19.2 instead of 26.4 kg; its legs weigh the same;
- `engines`: MuJoCo Warp, which must be installed. On a GPU only Warp can run there; MuJoCo stays on the CPU.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import mujoco
import torch
import tyro

from arrive.commands.threads import use_threads
from arrive.config import Config
from arrive.evaluation.arrival import choose_cells
from arrive.evaluation.difficulty import measure_difficulty
from arrive.files import write_json
from arrive.learning.policy import load_policy
from arrive.physics.device import DeviceWish, choose_device
from arrive.physics.options import PhysicsConfig, with_decimation
from arrive.robots import get_robot, register_robot
from arrive.robots.parts import Inertial, set_inertial

FINE_STEP_S = 0.001
LONG_STEPS = (3, 2)
"""Physics steps per policy step of `steps`."""

MENAGERIE_BASE = Inertial(19.2035, (0.0025, 0.0, 0.0502071), (0.217374, 0.639559, 0.624031, 0.0, 0.0, 0.0))
"""Of `anybotics_anymal_c/anymal_c.xml` in MuJoCo Menagerie (commit 1b428b0): without battery, sensors and hatch."""

Group = Literal["contacts", "fine", "steps", "motor", "network", "base", "engines"]
Variant = tuple[str, Config, torch.device]
"""Name, configuration and device."""


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


def variants(config: Config, arguments: Arguments) -> Iterator[Variant]:
    """All selected variants, the policy's own configuration first."""
    cpu = torch.device("cpu")
    yield "as trained", config, cpu
    for group in arguments.variants:
        if group == "base":
            yield "Menagerie's base", replace(config, robot=with_base(config.robot, MENAGERIE_BASE)), cpu
        elif group == "engines":
            yield (
                "MuJoCo Warp",
                replace(config, physics=replace(config.physics, engine="warp")),
                choose_device(arguments.device),
            )
        else:
            for label, physics in physics_of(group, config.physics, arguments.network):
                yield label, replace(config, physics=physics), cpu


def physics_of(group: Group, trained: PhysicsConfig, network: Path | None) -> Iterator[tuple[str, PhysicsConfig]]:
    """The variants of a group that differ in the settings of physics alone."""
    if group == "contacts":
        yield "legs pass through each other", replace(trained, leg_contacts=False)
    elif group == "fine":
        yield from fine(trained)
    elif group == "steps":
        for decimation in LONG_STEPS:
            physics = with_decimation(trained, decimation)
            yield f"{1e3 * physics.timestep_s:.3g} ms x {decimation}", physics
    elif group == "motor":
        yield "PD with the effort limit alone", replace(trained, motor="ideal")
    elif network is None:
        raise SystemExit("--variants network needs --network FILE")
    else:
        own = replace(trained, motor="network", motor_file=str(network.resolve()))
        yield "actuator network, affine clip", own
        yield "actuator network, constant clip", replace(own, motor_clip="constant")


def with_base(name: str, inertial: Inertial) -> str:
    """Register ANYmal C with another base; returns its name."""
    if name != "anymal_c":
        raise SystemExit(f"--variants base is for anymal_c, not {name}")
    robot = get_robot(name)

    def build_spec(visuals: bool) -> mujoco.MjSpec:
        spec = robot.build_spec(visuals)
        set_inertial(spec.body(robot.base_body), inertial)
        return spec

    base_kg = robot.model.body(robot.base_body).mass[0]
    other = replace(robot, name=f"{name}_menagerie", build_spec=build_spec, mass=robot.mass - base_kg + inertial.mass)
    register_robot(other)
    return other.name


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
    for label, config, device in variants(trained, arguments):
        policy = replace(load_policy(arguments.policy, device), config=config)
        found = measure_difficulty(policy, families, arguments.episodes, arguments.seed, threads=threads, chosen=chosen)
        for name, results in found.results.items():
            for result in results:
                print(f"{name} {result.cell.value}, {label}: {result.rate}", flush=True)
                rows.append({"terrain": name, "physics": label} | result.content())
        if arguments.json is not None:
            write_json(arguments.json, {"policy": str(arguments.policy), "seed": arguments.seed, "rows": rows})


if __name__ == "__main__":
    main(tyro.cli(Arguments))
