"""Which episodes end, and which of them count."""

from dataclasses import dataclass

from torch import Tensor

from arrive.task.memory import Memory
from arrive.task.state import State


@dataclass(frozen=True)
class Endings:
    """How a step left every episode; each (num_envs,) bool."""

    crashed: Tensor
    """Something touched that must not, or the simulation diverged."""
    fell: Tensor
    """The base fell into a hole."""
    failed: Tensor
    """One of the two: the episode ends before its time."""
    timed_out: Tensor
    """The time is over, and the robot did not fail."""
    ended: Tensor
    """The episode is over, of robots that are still simulated."""
    counted: Tensor
    """Its outcome would count: not for the shortened episodes with which a run begins, those that review an easier
    level, and diverged simulations."""


def end_episodes(state: State, memory: Memory, time_over: Tensor, own_level: Tensor) -> Endings:
    """Decide which episodes end (paper, section Episode Process: at a crash, in a hole, and when the time is over).

    Args:
        time_over: (num_envs,) bool: the task's time is over.
        own_level: (num_envs,) level of each robot by the curriculum; on a lower one it reviews.
    """
    fell = state.base_pos_w[:, 2] < state.fall_height
    crashed = (state.crash_contacts > 0) | ~state.finite
    failed = crashed | fell
    return Endings(
        crashed=crashed,
        fell=fell,
        failed=failed,
        timed_out=time_over & ~failed,
        ended=(time_over | failed) & ~memory.retired,
        counted=state.finite & ~memory.shortened & ~(memory.level < own_level),
    )
