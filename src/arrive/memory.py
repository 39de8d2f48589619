"""Estimates the memory that a command needs, before anything is built."""

import itertools
import math

from arrive.config import Config
from arrive.robots import get_robot
from arrive.room import check_room
from arrive.task.heights import FootHeightsConfig, HeightsConfig

WORLD = 0.4e6
"""A compiled world [bytes]. This and the next two are measured with MuJoCo 4.0.1 and torch 2.13 on x86-64."""
TILE = 0.9e6
"""A tile with its rasters [bytes]. Worlds may share one."""
ROBOT = 12e3
"""State of a robot in physics, task and statistics, without its observation [bytes]."""
OTHER_TERMS = 64
"""Observation entries other than heights, rounded up. The same number is used for actions and rewards."""
FLOAT = 4
NETWORKS = 2
COPIES = 3
"""Copies of a layer's output in the update: output, gradient, and one intermediate value."""
PARAMETER = 5 * FLOAT
"""Per network parameter: weight, gradient, the optimiser's two moments, and the recovery copy [bytes]."""


def check_worlds(worlds: int, tiles: int) -> None:
    """Check that the worlds of a configuration fit into memory.

    Raises:
        ArriveError: they do not fit.
    """
    each = WORLD + TILE * tiles / max(worlds, 1)
    check_room(worlds, each, "worlds", "terrain.variants and terrain.levels")


def check_robots(config: Config, worlds: int, tiles: int, learning: bool = False) -> None:
    """Check that the robots, and the networks and rollouts of training, fit into memory beside their worlds.

    Args:
        learning: whether networks are trained.

    Raises:
        ArriveError: they do not fit; the message says how many robots would.
    """
    fixed, each = WORLD * worlds + TILE * tiles, robot_bytes(config)
    if learning:
        check_room(1, network_bytes(config), "pair of networks", "ppo.hidden", fixed)
        fixed += network_bytes(config)
        each += learning_bytes(config)
    check_room(config.num_envs, each, "robots", "--num-envs", fixed)


def observed(config: Config) -> float:
    """Size of the observation, rounded up."""
    grid, feet = config.observation.heights, config.observation.foot_heights
    around_foot = _samples(feet) if feet.enabled else 0.0
    return OTHER_TERMS + _samples(grid) + len(get_robot(config.robot).foot_sites) * around_foot


def _samples(grid: HeightsConfig | FootHeightsConfig) -> float:
    return math.prod(extent / grid.step + 1 for extent in (grid.length, grid.width))


def robot_bytes(config: Config) -> float:
    """Memory per robot without training [bytes]. Looking up a height sample takes eight numbers."""
    return ROBOT + observed(config) * FLOAT * 8


def network_bytes(config: Config) -> float:
    """Memory of actor and critic in training [bytes]."""
    sizes = (observed(config), *config.ppo.hidden, OTHER_TERMS)
    return NETWORKS * PARAMETER * sum((a + 1) * b for a, b in itertools.pairwise(sizes))


def learning_bytes(config: Config) -> float:
    """Memory of an iteration per robot [bytes]: its rollout, and its share of a mini-batch with gradients."""
    ppo = config.ppo
    stored = FLOAT * (observed(config) + OTHER_TERMS)
    mini_batch = FLOAT * NETWORKS * COPIES * (observed(config) + sum(ppo.hidden)) / ppo.mini_batches
    return ppo.num_steps * (stored + mini_batch)
