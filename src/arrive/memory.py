"""What a command will need in memory, estimated before anything is built."""

import itertools
import math
from pathlib import Path

from arrive.config import Config
from arrive.errors import ArriveError

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


def free_memory() -> float:
    """Bytes that this process can still get, by the machine and its control group; infinite where nothing tells."""
    return min(_machine_free(), *(_group_free(*files) for files in GROUPS))


GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""Limit and use of a container's memory, in the two versions of Linux' control groups."""


def _machine_free() -> float:
    try:
        rows = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        return float(rows["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return float("inf")


def _group_free(limit: str, use: str) -> float:
    try:
        return float(Path(limit).read_text()) - float(Path(use).read_text())
    except (OSError, ValueError):  # no such group, or the limit is "max"
        return float("inf")


def check_room(count: int, each: float, what: str, advice: str, fixed: float = 0.0) -> None:
    """Make sure that so many of something fit into the memory that is free.

    Args:
        count: how many are asked for.
        each: bytes per piece.
        what: the pieces, for the message, such as "robots".
        advice: how to ask for fewer, such as "--num-envs".
        fixed: bytes that are needed beside them.

    Raises:
        ArriveError: they do not; says how many do.
    """
    # No number of pieces that a computer has is larger; integers may be too long for floating point.
    need, free = fixed + min(count, 10**18) * each, free_memory()
    if need <= free:
        return
    fitting = int(max(free - fixed, 0.0) // each)
    raise ArriveError(
        f"not enough memory for {count:,} {what}: about {need / 2**30:,.1f} GiB are needed and {free / 2**30:,.1f} GiB "
        f"are free; {f'{fitting:,} fit, ' if fitting else ''}choose less with {advice}"
    )


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
