"""Training one policy in several processes, started by torch's launcher (torchrun)."""

import os
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor

SEED_STEP = 104_729
"""Added per rank to the seed of terrain, episodes and action noise, so that processes differ in them."""


@dataclass(frozen=True)
class Ranks:
    """This process and the others that train with it. rsl_rl averages their gradients in every mini-batch.

    Rank 0 displays, logs and saves. A single process is rank 0 of 1 and does not communicate.
    """

    rank: int = 0
    count: int = 1

    @property
    def leads(self) -> bool:
        """Whether this process displays, logs and saves."""
        return self.rank == 0

    @property
    def seed_offset(self) -> int:
        """Added to the configuration's seed for everything random in this process except the networks."""
        return SEED_STEP * self.rank

    def settings(self) -> dict[str, int] | None:
        """rsl_rl's settings for several processes; None for a single one."""
        if self.count == 1:
            return None
        return {"global_rank": self.rank, "local_rank": _from_launcher("LOCAL_RANK", 0), "world_size": self.count}

    def any(self, flag: bool) -> bool:
        """Whether the flag is set in any process. Every process must call this."""
        if self.count == 1:
            return flag
        flags = torch.tensor(int(flag))
        dist.all_reduce(flags, dist.ReduceOp.MAX)
        return bool(flags)

    def any_of(self, flags: Tensor) -> Tensor:
        """Like `any`, for each flag of a bool tensor."""
        if self.count == 1:
            return flags
        numbers = flags.int().cpu()
        dist.all_reduce(numbers, dist.ReduceOp.MAX)
        return numbers.bool().to(flags.device)

    def gather(self, value: Any) -> list[Any]:
        """On rank 0, the values of all processes by rank; on other ranks, an empty list."""
        if self.count == 1:
            return [value]
        values = [None] * self.count if self.leads else None
        dist.gather_object(value, values)
        return values or []

    def share(self, value: Any) -> Any:
        """Rank 0's value in every process."""
        if self.count == 1:
            return value
        values = [value]
        dist.broadcast_object_list(values, src=0)
        return values[0]

    def leave(self) -> None:
        """Leave the process group, as the last step of a process."""
        if self.count > 1:
            dist.destroy_process_group()


ALONE = Ranks()


def join_ranks(device: torch.device) -> Ranks:
    """Join the processes that torchrun started. Without torchrun there is a single process.

    Args:
        device: device of this process. GPUs exchange gradients by NCCL; everything else uses Gloo.
    """
    count = _from_launcher("WORLD_SIZE", 1)
    if count == 1:
        return ALONE
    dist.init_process_group("gloo" if device.type == "cpu" else "cpu:gloo,cuda:nccl")
    return Ranks(dist.get_rank(), count)


def processes_here() -> int:
    """Number of processes on this machine, which share its CPUs."""
    return _from_launcher("LOCAL_WORLD_SIZE", 1)


def _from_launcher(name: str, alone: int) -> int:
    """An environment variable of torchrun, or the value for a single process."""
    return int(os.environ.get(name, alone))
