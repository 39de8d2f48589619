"""How many CPU threads a command uses."""

import os

import torch

from arrive.errors import ArriveError
from arrive.learning.ranks import processes_here


def use_threads(threads: int) -> int:
    """Give torch as many threads as physics; MuJoCo's and torch's threads take turns.

    0 takes every CPU, or this process's share of them.
    """
    if threads < 0:
        raise ArriveError(f"--threads must be 0 or more, not {threads}")
    threads = threads or max(len(os.sched_getaffinity(0)) // processes_here(), 1)
    torch.set_num_threads(threads)
    return threads
