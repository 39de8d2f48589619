"""Number of torch threads in the phases of training."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Let torch use only the calling thread, while robots act.

    Tensors are small then. After each operation, a second thread of torch's pool would spin for milliseconds on the
    core that a physics thread needs next.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
