"""Checks physics on a GPU, measures its throughput, and trains within a time budget.

    python benchmarks/gpu.py --minutes 20 --out runs/gpu     # 3 minutes of checks and timing, 20 of training
    python benchmarks/gpu.py --only train --minutes 60 --out runs/gpu  # continues that run
    python benchmarks/gpu.py --device cpu --num-envs 16 32 --steps 5 --minutes 0.5 --train-envs 16  # without a GPU

With `--device cpu`, physics is still MuJoCo Warp, on its slow CPU device.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch
import tyro

from arrive.build import Placement, build_env
from arrive.cli import main as arrive
from arrive.config import Config
from arrive.env import ArriveEnv
from arrive.errors import ArriveError
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.physics.cpu import CpuPhysics
from arrive.physics.device import choose_device, make_physics
from arrive.presets import robust
from arrive.terrain import FAMILIES

CHECK_LEVELS = 4
CHECK_ROBOTS = 64
CHECK_STATES = 10
WARM_UP_STEPS = 10
LIMITS = {"torque": 1e-3, "foot velocity": 1e-4, "acceleration, median": 0.05, "feet, share wrong": 0.005}
"""Largest accepted differences from MuJoCo in float64 [N m, m/s, m/s^2 or rad/s^2, share]."""


@dataclass(frozen=True)
class Benchmark:
    """Check, time and train on a GPU."""

    device: Literal["cuda", "cpu"] = "cuda"
    """Device to run on."""
    only: Literal["check", "time", "train"] | None = None
    """The only part to run; by default all three."""
    terrain: str = "all"
    """Terrain families to time and train on."""
    num_envs: tuple[int, ...] = (1024, 2048, 4096, 8192, 16384, 32768)
    """Numbers of robots to measure."""
    steps: int = 100
    """Policy steps to measure with each number of robots."""
    minutes: float = 10.0
    """Training time, measured from the start of the run [min]."""
    train_envs: int = 4096
    """Number of robots in the training."""
    out: Path = Path("runs/gpu")
    """Folder of the training run; one that exists is resumed."""


def families_of(names: str) -> tuple[str, ...]:
    return tuple(FAMILIES) if names == "all" else tuple(names.split(","))


def with_warp(config: Config) -> Config:
    return replace(config, physics=replace(config.physics, engine="warp"))


def check(device: torch.device) -> bool:
    """Step robots on every terrain from the same states with both engines; print the differences."""
    print(f"one physics step against MuJoCo, {CHECK_ROBOTS * CHECK_STATES} states each; limits: {LIMITS}")
    sound = True
    for family in FAMILIES:
        found = differences(family, device)
        good = all(found[name] <= limit for name, limit in LIMITS.items())
        sound = sound and good
        figures = ", ".join(f"{name} {value:.1e}" for name, value in found.items())
        print(f"  {family:12s} {'ok ' if good else 'BAD'} {figures}", flush=True)
    return sound


def differences(family: str, device: torch.device) -> dict[str, float]:
    """The differences that `LIMITS` bounds, over states of robots that move randomly on a terrain family."""
    config = robust()
    terrain = replace(config.terrain, families=(family,), levels=CHECK_LEVELS, variants=1)
    config = replace(config, num_envs=CHECK_ROBOTS, terrain=terrain)
    env = build_env(config, Placement(assignment=assign_levels(config)), threads=1)
    once = replace(config.physics, decimation=1, engine="warp")
    reference = CpuPhysics(env.robot, env.pool.worlds, once, CHECK_ROBOTS, 1)
    engine = make_physics(env.robot, env.pool.worlds, once, CHECK_ROBOTS, 1, device)
    generator = torch.Generator().manual_seed(1)
    rows = []
    for _ in range(CHECK_STATES):
        for _ in range(6):
            actions = 0.5 * torch.randn(CHECK_ROBOTS, env.num_actions, generator=generator)
            env.step(actions)
        state = env.physics.state_dict()
        targets = torch.tensor(env.robot.default_joint_pos) + env.robot.action_scale * actions
        reference.load_state_dict(state)
        engine.load_state_dict(state)
        reference.step(targets)
        engine.step(targets.to(device))
        rows.append(compare(reference, engine))
    torque, velocity, acceleration, wrong = (torch.cat(parts) for parts in zip(*rows, strict=True))
    values = (torque.max(), velocity.max(), acceleration.median(), wrong.float().mean())
    return dict(zip(LIMITS, map(float, values), strict=True))


def assign_levels(config: Config) -> tuple[torch.Tensor, torch.Tensor]:
    """The family and a level for each robot."""
    family = FAMILIES[config.terrain.families[0]]
    levels = 1 if family.lowest == family.highest else config.terrain.levels
    return torch.zeros(config.num_envs, dtype=torch.long), torch.arange(config.num_envs) % levels


def compare(reference, engine) -> tuple[torch.Tensor, ...]:
    """(n,) differences in torque, foot velocity and acceleration; (n, feet) bool: different contact."""
    expected, seen = reference.read(), engine.read()
    torque = (seen.joint_torque.cpu() - expected.joint_torque).abs().amax(-1)
    velocity = (seen.foot_vel_w.cpu() - expected.foot_vel_w).abs().amax((-2, -1))
    due, found = (each.state_dict()["qacc_warmstart"].cpu().double() for each in (reference, engine))
    wrong = (seen.foot_contacts.cpu() > 0) != (expected.foot_contacts > 0)
    return torque, velocity, (found - due).abs().amax(-1), wrong


def time_steps(command: Benchmark, device: torch.device) -> None:
    """Print policy steps per second and the share of physics for every number of robots."""
    print(f"{command.terrain} on {device}, {command.steps} policy steps with random actions")
    print("  robots  env steps/s  physics  start [s]  memory [GiB]")
    for num_envs in command.num_envs:
        config = robust()
        config = replace(
            config, num_envs=num_envs, terrain=replace(config.terrain, families=families_of(command.terrain))
        )
        begun = time.perf_counter()
        env = build_env(with_warp(config), device=device)
        run(env, WARM_UP_STEPS, device)
        built = time.perf_counter() - begun
        whole = run(env, command.steps, device)
        with timed_physics(env, device) as physics:
            observed = run(env, command.steps, device)
        memory = torch.cuda.mem_get_info(device) if device.type == "cuda" else (0, 0)
        rate = num_envs * command.steps / whole
        gib = (memory[1] - memory[0]) / 2**30
        share = sum(physics) / observed
        print(f"  {num_envs:6d}  {rate:11,.0f}  {share:7.0%}  {built:9.1f}  {gib:12.1f}", flush=True)
        del env


def run(env: ArriveEnv, steps: int, device: torch.device) -> float:
    """Wall time of policy steps with random actions [s]."""
    synchronise(device)
    begun = time.perf_counter()
    with torch.inference_mode():
        for _ in range(steps):
            env.step(0.3 * torch.randn(env.num_envs, env.num_actions, device=device))
    synchronise(device)
    return time.perf_counter() - begun


@contextmanager
def timed_physics(env: ArriveEnv, device: torch.device) -> Iterator[list[float]]:
    """Yield a list to which every engine step appends its wall time [s], with the GPU synchronised before and after."""
    times: list[float] = []
    step = env.physics.step

    def timing(targets: torch.Tensor) -> None:
        synchronise(device)
        begun = time.perf_counter()
        step(targets)
        synchronise(device)
        times.append(time.perf_counter() - begun)

    env.physics.step = timing
    yield times
    env.physics.step = step


def synchronise(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def train(command: Benchmark) -> None:
    """Train, or continue a training, until the budget is spent."""
    options = ["train", command.terrain, "--minutes", str(command.minutes), "--device", command.device]
    if (command.out / CHECKPOINT_NAME).is_file():
        options += ["--resume", str(command.out)]
    else:
        options += ["--num-envs", str(command.train_envs), "--out", str(command.out), "--set", "physics.engine=warp"]
    arrive(options)


def main() -> None:
    """Run the selected parts. A failed check stops the benchmark before timing and training."""
    command = tyro.cli(Benchmark, description=__doc__)
    device = choose_device(command.device)
    if command.only in (None, "check") and not check(device):
        raise ArriveError("physics is not MuJoCo's on this device, see BAD above; nothing was timed or trained")
    if command.only in (None, "time"):
        time_steps(command, device)
    if command.only in (None, "train"):
        train(command)


if __name__ == "__main__":
    try:
        main()
    except ArriveError as error:
        print(f"gpu: {error}", file=sys.stderr)
        sys.exit(1)
