"""How many CPU threads a command uses."""

import os

import torch

from arrive.errors import ArriveError


def use_threads(threads: int) -> int:
    """Give torch as many threads as physics; MuJoCo's and torch's threads take turns."""
    if threads < 0:
        raise ArriveError(f"--threads must be 0 or more, not {threads}")
    threads = threads or len(os.sched_getaffinity(0))
    torch.set_num_threads(threads)
    return threads
