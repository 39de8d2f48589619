"""What a command will need in memory, estimated before anything is built."""

import itertools
import math

from arrive.config import Config
from arrive.room import check_room

WORLD = 0.4e6
"""A compiled world [bytes], as the others measured with MuJoCo 4.0.1 and torch 2.13 on x86-64."""
TILE = 0.9e6
"""Its tile, where it has one of its own, with rasters."""
ROBOT = 12e3
"""State of a robot in physics, task and statistics, without what it observes."""
OTHER_TERMS = 64
"""Observed numbers that are no heights, rounded up; robots' actions and rewards are counted by the same number."""
FLOAT = 4
NETWORKS = 2
COPIES = 3
"""Of what a layer computes in the update: forward, gradient, and one in between."""
PARAMETER = 5 * FLOAT
"""A weight, its gradient, two averages of the optimiser, and the copy to go back to."""


def check_worlds(worlds: int, tiles: int) -> None:
    """Make sure that the worlds of a configuration fit.

    Raises:
        ArriveError: they do not.
    """
    each = WORLD + TILE * tiles / max(worlds, 1)
    check_room(worlds, each, "worlds", "terrain.variants and terrain.levels")


def check_robots(config: Config, worlds: int, tiles: int, learning: bool = False) -> None:
    """Make sure that robots, and what they learn with, fit beside their worlds.

    Args:
        learning: whether networks are trained on what the robots do.

    Raises:
        ArriveError: they do not; says how many robots do.
    """
    fixed, each = WORLD * worlds + TILE * tiles, robot_bytes(config)
    if learning:
        check_room(1, network_bytes(config), "pair of networks", "ppo.hidden", fixed)
        fixed += network_bytes(config)
        each += learning_bytes(config)
    check_room(config.num_envs, each, "robots", "--num-envs", fixed)


def observed(config: Config) -> float:
    """Numbers that a robot observes, rounded up."""
    grid = config.observation.heights
    return OTHER_TERMS + math.prod(extent / grid.step + 1 for extent in (grid.length, grid.width))


def robot_bytes(config: Config) -> float:
    """Memory per robot without learning: a height sample is looked up through eight numbers."""
    return ROBOT + observed(config) * FLOAT * 8


def network_bytes(config: Config) -> float:
    """Memory of actor and critic in training."""
    sizes = (observed(config), *config.ppo.hidden, OTHER_TERMS)
    return NETWORKS * PARAMETER * sum((a + 1) * b for a, b in itertools.pairwise(sizes))


def learning_bytes(config: Config) -> float:
    """Memory per robot of an iteration: what is stored of each step, and its share of a mini-batch with gradients."""
    ppo = config.ppo
    stored = FLOAT * (observed(config) + OTHER_TERMS)
    mini_batch = FLOAT * NETWORKS * COPIES * (observed(config) + sum(ppo.hidden)) / ppo.mini_batches
    return ppo.num_steps * (stored + mini_batch)
