"""Other processes on this machine, and how to leave them the CPUs that we only wait on.

Waiting threads of torch's OpenMP pool spin. Alone on a machine that makes the update a third faster than sleeping does
(docs/performance.md). Beside a process that keeps a CPU busy, a thread that works waits for one that spins.
"""

import os
import time
from pathlib import Path

STAT = Path("/proc/stat")
LOOK_S = 0.2
"""How long to look at the machine; the kernel counts in hundredths of a second."""
BUSY_CPUS = 0.5
"""Neighbours that keep more CPUs than this busy make waiting threads sleep."""
CHOSEN = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "LOCAL_WORLD_SIZE")
"""Variables of who has chosen already: a person, or torchrun, whose processes are each other's neighbours."""


def wait_considerately() -> None:
    """Let torch's waiting threads sleep if others need the CPUs; call before torch is loaded, which reads it then.

    The numbers that are computed do not depend on it.
    """
    if not any(name in os.environ for name in CHOSEN) and busy_cpus() > BUSY_CPUS:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"


def busy_cpus(seconds: float = LOOK_S) -> float:
    """How many of the CPUs that this process may use others keep busy, while it sleeps; 0 where nothing tells."""
    before = _seconds()
    start = time.monotonic()
    time.sleep(seconds)
    return max(_seconds() - before, 0.0) / (time.monotonic() - start)


def _seconds() -> float:
    """Time that this process's CPUs have worked since the machine started [s]; see proc_stat(5)."""
    try:
        mine = {f"cpu{number}" for number in os.sched_getaffinity(0)}
        rows = [line.split() for line in STAT.read_text().splitlines()]
        # user, nice, system, idle, iowait, irq, softirq, steal
        ticks = sum(int(row[i]) for row in rows if row[0] in mine for i in (1, 2, 3, 6, 7, 8))
        return ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, ValueError, IndexError):
        return 0.0
