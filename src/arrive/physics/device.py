"""Choice of the device of a run, and of its physics engine."""

import importlib.util
import os
from collections.abc import Sequence
from typing import Literal

import mujoco
import torch

from arrive.actuation.network import ActuatorNetwork
from arrive.errors import ArriveError
from arrive.physics.engine import Physics
from arrive.physics.motors import network_motors
from arrive.physics.options import PhysicsConfig
from arrive.robots.robot import Robot

DeviceWish = Literal["auto", "cpu", "cuda"]
INSTALL_WARP = "pip install 'warp-lang>=1.19' 'absl-py>=2', then pip install --no-deps mujoco-warp"


def why_no_gpu() -> str:
    """Why this process cannot train on a GPU, and what to do about it; empty if it can."""
    if torch.version.cuda is None:
        return "this torch is built without CUDA: install one with it, see pytorch.org/get-started"
    if not torch.cuda.is_available():
        return "torch finds no NVIDIA GPU or driver: check that nvidia-smi lists one and CUDA_VISIBLE_DEVICES allows it"
    if not has_warp():
        return f"MuJoCo Warp is not installed: {INSTALL_WARP}"
    return ""


def has_warp() -> bool:
    """Whether MuJoCo Warp is installed."""
    return all(importlib.util.find_spec(name) is not None for name in ("warp", "mujoco_warp"))


def choose_device(wish: DeviceWish) -> torch.device:
    """The device to use. With several processes on a machine, each one takes the GPU of its local rank.

    Raises:
        ArriveError: `cuda` without a usable GPU.
    """
    problem = why_no_gpu() if wish != "cpu" else ""
    if wish == "cuda" and problem:
        raise ArriveError(f"--device cuda: {problem}")
    if wish == "cpu" or problem:
        return torch.device("cpu")
    index = int(os.environ.get("LOCAL_RANK", "0"))
    if index >= torch.cuda.device_count():
        raise ArriveError(
            f"process {index} of this machine has no GPU: start {torch.cuda.device_count()}, as many as there are"
        )
    torch.cuda.set_device(index)
    return torch.device("cuda", index)


def engine_for(engine: str, device: torch.device) -> str:
    """The engine that `physics.engine` selects on a device."""
    return engine if engine != "auto" else {"cpu": "mujoco", "cuda": "warp"}[device.type]


def describe_device(device: torch.device, wish: DeviceWish, threads: int, engine: str = "auto") -> str:
    """One line about the chosen device and the reason.

    Args:
        engine: `physics.engine` of the configuration.
    """
    physics = {"mujoco": "MuJoCo", "warp": "MuJoCo Warp"}[engine_for(engine, device)]
    if device.type == "cuda":
        return f"device: {torch.cuda.get_device_name(device)} ({device}), physics by {physics}"
    reason = f"; no GPU is used: {why_no_gpu()}" if wish == "auto" else ""
    return f"device: CPU, {threads} threads, physics by {physics}{reason}"


def make_physics(
    robot: Robot,
    worlds: Sequence[mujoco.MjModel],
    config: PhysicsConfig,
    num_envs: int,
    threads: int,
    device: torch.device,
    network: ActuatorNetwork | None = None,
) -> Physics:
    """Build the engine that the configuration names, or the one for the device.

    Args:
        network: actuator network of `physics.motor=network`, see `motor_network`.

    Raises:
        ArriveError: the configuration asks for MuJoCo's batch on a GPU, or MuJoCo Warp is not installed.
    """
    if engine_for(config.engine, device) == "mujoco":
        if device.type != "cpu":
            raise ArriveError("physics.engine=mujoco runs on the CPU: choose --device cpu, or physics.engine=auto")
        from arrive.physics.cpu import CpuPhysics

        motors = network_motors(config, robot, num_envs, network)
        return CpuPhysics(robot, worlds, config, num_envs, threads, motors)
    if not has_warp():
        raise ArriveError(f"MuJoCo Warp is not installed: {INSTALL_WARP}")
    from arrive.physics.warp import WarpPhysics

    return WarpPhysics(robot, worlds, config, num_envs, device, network)
