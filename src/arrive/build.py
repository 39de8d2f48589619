"""Puts an environment together from a configuration."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from arrive.config import Config, check
from arrive.env import ArriveEnv
from arrive.memory import check_robots, check_worlds
from arrive.physics.device import make_physics
from arrive.physics.motors import motor_network
from arrive.physics.pool import Spread, TileSet, build_pool
from arrive.robots import get_robot
from arrive.task.registry import get_task
from arrive.task.task import Cruise, Setting, Trial
from arrive.terrain import Family, Layout, get_family
from arrive.terrain.levels import level_values


@dataclass(frozen=True)
class Placement:
    """Which terrain the environments stand on, where it is not the training curriculum's."""

    layout: Layout = "training"
    values: tuple[tuple[float, ...], ...] | None = None
    """Parameters of each family's levels; None for the curriculum's."""
    seed_offset: int = 0
    """Added to the configuration's seed for terrain, friction and payload."""
    trial: Trial | Cruise | None = None
    """The errand or the constant command of every robot; None to draw commands."""
    assignment: tuple[Tensor, Tensor] | None = None
    """Family and level of each environment, fixed; None for the curriculum."""


Progress = Callable[[int, int], None]


def build_env(
    config: Config,
    placement: Placement = Placement(),
    threads: int = 0,
    progress: Progress = lambda done, total: None,
    device: torch.device | str | None = None,
    learning: bool = False,
) -> ArriveEnv:
    """Build tiles, worlds, physics, task and environment.

    Args:
        threads: physics threads; 0 takes one per CPU.
        progress: told worlds compiled so far and their number.
        device: where the robots live: the CPU or a GPU (see `choose_device`); by default where the placement's
            assignment is, or else the CPU.
        learning: whether networks are going to be trained on what the robots do, for which room must be left.

    Raises:
        ArriveError: the configuration names something unknown, asks for nothing, or needs more memory than is free.
    """
    check(config)
    network = motor_network(config.physics)  # before the worlds, so that a bad file is told at once
    robot = get_robot(config.robot)
    families = tuple(get_family(name) for name in config.terrain.families)
    _check_memory(config, families, placement.values, learning)
    values = placement.values or tuple(level_values(family, config.terrain.levels) for family in families)
    seed = config.seed + placement.seed_offset
    if device is None:
        device = "cpu" if placement.assignment is None else placement.assignment[0].device
    device = torch.device(device)
    tile_set = TileSet(families, values, placement.layout, config.terrain.variants)
    spread = Spread(config.randomisation.friction, config.randomisation.payload_kg)
    pool = build_pool(robot, tile_set, spread, config.physics, seed, progress).to(device)
    physics = make_physics(robot, pool.worlds, config.physics, config.num_envs, threads, device, network)
    generator = torch.Generator(device).manual_seed(seed)
    setting = Setting(config.num_envs, config.physics.control_dt, pool.rasters, generator)
    task = get_task(config.task.name)(config.task, setting, placement.trial)
    return ArriveEnv(config, robot, pool, physics, task, generator, placement.assignment)


def _check_memory(
    config: Config, families: tuple[Family, ...], values: tuple[tuple[float, ...], ...] | None, learning: bool
) -> None:
    """Refuse what does not fit, before anything of it is built."""
    variants = config.terrain.variants
    levels = [len(own) for own in values] if values else [config.terrain.levels] * len(families)
    worlds = variants * sum(levels)
    tiles = sum(count * (variants if family.random else 1) for family, count in zip(families, levels, strict=True))
    check_worlds(worlds, tiles)
    check_robots(config, worlds, tiles, learning)
