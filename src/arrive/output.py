"""Standard output and standard error that fail without ending the program.

A reader may leave (`arrive eval gap | head`), a terminal may close, and a disk may be full. Work that takes minutes is
not lost for that: what cannot be written is dropped, and the program goes on.
"""

import errno
import io
import os
import sys
from typing import Any, TextIO

READER_LEFT = (errno.EPIPE, errno.EIO)
"""Errors after which nobody reads: a closed pipe, a closed terminal."""


class Lasting(io.FileIO):
    """A file descriptor on which writing never raises."""

    failure: OSError | None = None
    """Why output was dropped."""

    def write(self, data: Any, /) -> int:
        """Write, or drop the data once writing has failed."""
        if self.failure is None:
            try:
                return super().write(data)
            except OSError as error:
                self.failure = error
        return memoryview(data).nbytes


def make_output_last() -> None:
    """Replace standard output and standard error by streams that never raise, also where they are closed."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass  # a file of ours on a closed descriptor would take what libraries print
    os.close(number)
    sys.stdout, sys.stderr = _lasting(sys.stdout, 1), _lasting(sys.stderr, 2)


def _lasting(stream: TextIO | None, number: int) -> TextIO:
    raw = Lasting(number, "wb", closefd=False)
    if not isinstance(stream, io.TextIOWrapper):  # closed
        return io.TextIOWrapper(io.BufferedWriter(raw), "utf-8")
    stream.flush()
    buffer = raw if stream.write_through else io.BufferedWriter(raw)
    return io.TextIOWrapper(
        buffer,
        stream.encoding,
        "backslashreplace",
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def lost_output() -> str:
    """Why standard output is incomplete although somebody may read it, such as a full disk; otherwise empty."""
    sys.stdout.flush()
    raw = getattr(sys.stdout.buffer, "raw", sys.stdout.buffer)
    failure = raw.failure if isinstance(raw, Lasting) else None
    return "" if failure is None or failure.errno in READER_LEFT else failure.strerror or str(failure)
