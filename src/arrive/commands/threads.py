"""Number of CPU threads of a command."""

import os

import torch

from arrive.errors import ArriveError
from arrive.learning.ranks import processes_here

THREADS_PER_CPU = 4
"""Limit on threads: more bring nothing and take memory."""


def check_threads(threads: int) -> None:
    """Check a number of threads.

    Raises:
        ArriveError: it is no integer, below 0, or more than this machine has a use for.
    """
    most = THREADS_PER_CPU * (os.cpu_count() or 1)
    if type(threads) is not int or not 0 <= threads <= most:
        raise ArriveError(f"--threads must be 0 to {most} on this machine of {os.cpu_count()} CPUs, not {threads!r}")


def use_threads(threads: int) -> int:
    """Give torch as many threads as physics, because MuJoCo's and torch's threads take turns.

    0 takes every CPU, or this process's share of them.
    """
    check_threads(threads)
    threads = threads or max(len(os.sched_getaffinity(0)) // processes_here(), 1)
    torch.set_num_threads(threads)
    return threads
