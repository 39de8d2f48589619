"""Builds an environment from a configuration."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from arrive.config import Config, check_config
from arrive.env import ArriveEnv
from arrive.memory import check_robots, check_worlds
from arrive.physics.device import make_physics
from arrive.physics.motors import motor_network
from arrive.physics.pool import TileSet, WorldRandomisation, build_pool
from arrive.robots import get_robot
from arrive.task.final import PositionConfig
from arrive.task.registry import get_task
from arrive.task.task import ConstantCommand, TaskContext, Trial
from arrive.terrain import Family, Layout, get_family
from arrive.terrain.build import TARGET_DISTANCE
from arrive.terrain.levels import level_values


@dataclass(frozen=True)
class Placement:
    """Terrain and commands of the environments, where they differ from training."""

    layout: Layout = "training"
    values: tuple[tuple[float, ...], ...] | None = None
    """Parameters of each family's levels; None for those of training."""
    seed_offset: int = 0
    """Added to the configuration's seed for terrain, friction and payload."""
    trial: Trial | ConstantCommand | None = None
    """A fixed command for the robots; None for random commands."""
    assignment: tuple[Tensor, Tensor] | None = None
    """Fixed family and level of each environment; None for the curriculum."""


OnProgress = Callable[[int, int], None]
"""Called with the number of finished parts and their total."""


def build_env(
    config: Config,
    placement: Placement = Placement(),
    threads: int = 0,
    progress: OnProgress = lambda done, total: None,
    device: torch.device | str | None = None,
    learning: bool = False,
) -> ArriveEnv:
    """Build tiles, worlds, physics, task and environment.

    Args:
        threads: physics threads; 0 takes one per CPU.
        progress: called with the number of worlds compiled so far and their total.
        device: where to simulate: the CPU or a GPU (see `choose_device`). The default is the device of the placement's
            assignment, or else the CPU.
        learning: whether networks will be trained, for which memory must be left.

    Raises:
        ArriveError: the configuration is invalid, or needs more memory than is free.
    """
    check_config(config)
    network = motor_network(config.physics)  # before the worlds, so that a bad file is reported at once
    robot = get_robot(config.robot)
    families = tuple(get_family(name) for name in config.terrain.families)
    _check_memory(config, families, placement.values, learning)
    values = placement.values or tuple(level_values(family, config.terrain.levels) for family in families)
    seed = config.seed + placement.seed_offset
    if device is None:
        device = "cpu" if placement.assignment is None else placement.assignment[0].device
    device = torch.device(device)
    distance = config.task.target_distance if isinstance(config.task, PositionConfig) else TARGET_DISTANCE
    tile_set = TileSet(families, values, placement.layout, config.terrain.variants, distance)
    spread = WorldRandomisation(config.randomisation.friction, config.randomisation.payload_kg)
    pool = build_pool(robot, tile_set, spread, config.physics, seed, progress).to(device)
    physics = make_physics(robot, pool.worlds, config.physics, config.num_envs, threads, device, network)
    generator = torch.Generator(device).manual_seed(seed)
    context = TaskContext(config.num_envs, config.physics.control_dt, pool.rasters, generator)
    task = get_task(config.task.name)(config.task, context, placement.trial)
    return ArriveEnv(config, robot, pool, physics, task, generator, placement.assignment)


def _check_memory(
    config: Config, families: tuple[Family, ...], values: tuple[tuple[float, ...], ...] | None, learning: bool
) -> None:
    """Raise an error if the worlds and robots do not fit into memory, before anything is built."""
    variants = config.terrain.variants
    levels = [len(own) for own in values] if values else [config.terrain.levels] * len(families)
    worlds = variants * sum(levels)
    tiles = sum(count * (variants if family.random else 1) for family, count in zip(families, levels, strict=True))
    check_worlds(worlds, tiles)
    check_robots(config, worlds, tiles, learning)
