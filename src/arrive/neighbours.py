"""Detects other busy processes and then lets torch's waiting threads sleep.

Waiting threads of torch's OpenMP pool spin. On an idle machine this makes the update a third faster than sleeping
(docs/performance.md). Beside another busy process, spinning threads take CPU time from working ones.
"""

import os
import time
from pathlib import Path

STAT = Path("/proc/stat")
LOOK_S = 0.2
"""Duration of the measurement [s]. The kernel's counters have a resolution of 0.01 s."""
BUSY_CPUS = 0.5
"""If other processes keep more CPUs than this busy, waiting threads sleep."""
CHOSEN = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "LOCAL_WORLD_SIZE")
"""If one of these variables is set, the user has already chosen, or torchrun runs several of our processes."""


def wait_considerately() -> None:
    """Let torch's waiting threads sleep if other processes need the CPUs. Results do not depend on it.

    Call this before torch is loaded, because torch reads the setting then.
    """
    if not any(name in os.environ for name in CHOSEN) and busy_cpus() > BUSY_CPUS:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"


def busy_cpus(seconds: float = LOOK_S) -> float:
    """Number of this process's CPUs that other processes keep busy, measured while it sleeps; 0 if unknown."""
    before = _seconds()
    start = time.monotonic()
    time.sleep(seconds)
    return max(_seconds() - before, 0.0) / (time.monotonic() - start)


def _seconds() -> float:
    """Busy time of the CPUs that this process may use, since the machine started [s]; see proc_stat(5)."""
    try:
        mine = {f"cpu{number}" for number in os.sched_getaffinity(0)}
        rows = [line.split() for line in STAT.read_text().splitlines()]
        # user, nice, system, idle, iowait, irq, softirq, steal
        ticks = sum(int(row[i]) for row in rows if row[0] in mine for i in (1, 2, 3, 6, 7, 8))
        return ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, ValueError, IndexError):
        return 0.0
