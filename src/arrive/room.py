"""Free memory, and a check that a number of items fits into it."""

from pathlib import Path

from arrive.errors import ArriveError


def free_memory() -> float:
    """Memory that this process can still get, by the machine and its control group; infinite if unknown [bytes]."""
    return min(_machine_free(), *(_group_free(*files) for files in GROUPS))


GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""Files with limit and use of a container's memory, in the two versions of Linux control groups."""


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
    """Check that a number of items fits into free memory.

    Args:
        count: number of items.
        each: bytes per item.
        what: name of the items, for the message, such as "robots".
        advice: the option that reduces the number, such as "--num-envs".
        fixed: bytes needed besides the items.

    Raises:
        ArriveError: they do not fit; the message says how many would.
    """
    # Limited, because a very large integer does not convert to a float.
    need, free = fixed + min(count, 10**18) * each, free_memory()
    if need <= free:
        return
    fitting = int(max(free - fixed, 0.0) // each)
    raise ArriveError(
        f"not enough memory for {count:,} {what}: about {need / 2**30:,.1f} GiB are needed and {free / 2**30:,.1f} GiB "
        f"are free; {f'{fitting:,} fit, ' if fitting else ''}choose fewer with {advice}"
    )
