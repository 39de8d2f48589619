"""Ctrl-C while the program starts and ends.

Loading libraries takes seconds. A KeyboardInterrupt in the middle of an import is no help: libraries in C turn it into
errors of their own, and there is nothing yet that could be saved. So the program leaves at once then, with one line.
"""

import os
import signal

INTERRUPTED = 130
"""Exit status of a program that Ctrl-C ended, as shells have it: 128 and the signal's number."""


def _leave(number: int, frame: object) -> None:
    os.write(2, b"arrive: interrupted\n")
    os._exit(INTERRUPTED)


def leave_at_once() -> None:
    """Let Ctrl-C end the process without more ado."""
    signal.signal(signal.SIGINT, _leave)


def interrupt_again() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again, where `leave_at_once` was called."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)
