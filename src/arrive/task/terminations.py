"""Terminations: which episodes end, and which of them count."""

from dataclasses import dataclass

from torch import Tensor

from arrive.task.memory import Memory
from arrive.task.state import State


@dataclass(frozen=True)
class Endings:
    """Which episodes ended in a step, and why; each (num_envs,) bool."""

    crashed: Tensor
    """A body touched something that must not, or the simulation diverged."""
    fell: Tensor
    """The base fell into a hole."""
    failed: Tensor
    """Crashed or fell: the episode ends early."""
    timed_out: Tensor
    """The time is up and the robot did not fail."""
    ended: Tensor
    """The episode is over and the robot is still simulated."""
    counted: Tensor
    """The outcome counts for success rate and curriculum. Excluded are a run's shortened first episodes, episodes on an
    easier level than the robot's own, and diverged simulations."""


def end_episodes(state: State, memory: Memory, time_over: Tensor, own_level: Tensor) -> Endings:
    """Find the episodes that end: at a crash, in a hole, or when the time is up (paper, section Episode Process).

    Args:
        time_over: (num_envs,) bool: the task's time is up.
        own_level: (num_envs,) level of each robot in the curriculum. Episodes on a lower level do not count.
    """
    fell = state.base_pos_w[:, 2] < state.fall_height
    crashed = (state.crash_contacts > 0) | ~state.finite
    failed = crashed | fell
    return Endings(
        crashed=crashed,
        fell=fell,
        failed=failed,
        timed_out=time_over & ~failed,
        ended=(time_over | failed) & ~memory.inactive,
        counted=state.finite & ~memory.shortened & ~(memory.level < own_level),
    )
