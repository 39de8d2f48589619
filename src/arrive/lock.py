"""A lock that names its owner, for files and folders that only one process may write."""

import fcntl
import json
import os
import socket
from pathlib import Path
from types import TracebackType

from arrive.errors import ArriveError
from arrive.files import cannot_write

LONGEST_HOST = 255


class Lock:
    """Context manager around a lock file that names the owner's process and host. `release` removes the file.

    The kernel's lock on the file (`flock`) ends with the process that holds it, even after a kill, so a file left
    behind is taken over. A file left by a process on another host is never taken over, because this host cannot tell
    whether that process is alive.
    """

    def __init__(self, path: Path, what: str):
        """
        Args:
            path: the lock file.
            what: what the lock guards, for messages.
        """
        self.path, self._what = path, what
        self._handle: int | None = None

    @property
    def handle(self) -> int:
        """The file descriptor. A child process that inherits it holds the lock too."""
        if self._handle is None:
            raise RuntimeError(f"{self.path} is not held")
        return self._handle

    def acquire(self) -> None:
        """Take the lock.

        Raises:
            ArriveError: another process holds it, or the file cannot be written.
        """
        try:
            while self._handle is None:
                self._try()
        except OSError as error:
            raise cannot_write(self.path, error) from error

    def _try(self) -> None:
        """Lock the file, unless its owner removed it after we opened it and before we locked it."""
        handle = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise self._held_by_another(os.pread(handle, 4096, 0)) from None
            if not self._is_at_path(handle):
                os.close(handle)
                return
            self._take(handle)
        except BaseException:
            os.close(handle)
            raise
        self._handle = handle

    def _take(self, handle: int) -> None:
        """Write our process and host into the file, over those of a process that has ended."""
        _, host = _owner(os.pread(handle, 4096, 0))
        if host not in (None, socket.gethostname()):
            raise self._held_by_another(os.pread(handle, 4096, 0))
        os.ftruncate(handle, 0)
        os.pwrite(handle, json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode(), 0)

    def _held_by_another(self, content: bytes) -> ArriveError:
        pid, host = _owner(content)
        message = f"{self._what} is in use by process {pid or '(unknown)'}"
        if host in (None, socket.gethostname()):
            return ArriveError(f"{message}. Wait for it, or end it with Ctrl-C or `kill {pid or 'PID'}`.")
        return ArriveError(f"{message} on {host}. If that process has ended, delete {self.path} and try again.")

    def _is_at_path(self, handle: int) -> bool:
        try:
            return os.path.samestat(os.fstat(handle), os.stat(self.path))
        except FileNotFoundError:
            return False

    def check(self) -> None:
        """Check that the file is still there, so that the lock still holds.

        Raises:
            ArriveError: somebody has removed or replaced it.
        """
        if not self._is_at_path(self.handle):
            raise ArriveError(f"{self.path} was removed while {self._what} was in use; nothing more is written there")

    def release(self) -> None:
        """Remove the file and release the lock."""
        if self._handle is None:
            return
        try:
            if self._is_at_path(self._handle):
                self.path.unlink(missing_ok=True)
        except OSError:  # a disk that has become read-only: the lock ends with the handle
            pass
        finally:
            os.close(self._handle)
            self._handle = None

    def __enter__(self) -> "Lock":
        self.acquire()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def _owner(content: bytes) -> tuple[int | None, str | None]:
    """Process and host in a lock file; None if its owner was killed before it wrote them, or the file is damaged."""
    try:
        owner = json.loads(content)
        pid, host = owner["pid"], owner["host"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None, None
    if type(pid) is not int or not 0 < pid < 2**63 or not isinstance(host, str) or not 0 < len(host) <= LONGEST_HOST:
        return None, None
    return pid, host
