"""Handles Ctrl-C while the program starts and ends.

Loading libraries takes seconds. A KeyboardInterrupt during an import does not work well, because C libraries turn it
into errors of their own. There is nothing to save at that time, so the program exits at once with one line.
"""

import os
import signal

INTERRUPTED = 130
"""Exit status after Ctrl-C, as in shells: 128 plus the signal number."""


def _leave(number: int, frame: object) -> None:
    os.write(2, b"arrive: interrupted\n")
    os._exit(INTERRUPTED)


def leave_at_once() -> None:
    """Make Ctrl-C end the process at once, unless it was told to ignore it, as shells tell jobs in the background."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _leave)


def interrupt_again() -> None:
    """Make Ctrl-C raise KeyboardInterrupt again, if `leave_at_once` was called."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)
