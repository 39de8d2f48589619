"""How much memory is free, and whether so many of something fit into it."""

from pathlib import Path

from arrive.errors import ArriveError


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
