"""How many threads torch uses in which phase."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """While robots act, torch computes on the calling thread alone.

    Its tensors are small there, and a second thread of its pool would spin for milliseconds after each of them, on the
    very core that a physics thread needs next.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
