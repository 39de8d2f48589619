"""Atomic writing of files, and careful reading."""

import json
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from arrive.errors import ArriveError

TEMPORARY = ".tmp"
"""Marks files that are not complete yet. They are named `.NAME.RANDOM.tmp` plus the suffix of NAME."""
LARGEST_FILE = 2**32
"""Larger files are refused instead of being read into memory [bytes]."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield a temporary file to write. It replaces `path` once it is complete and on disk.

    A failure, an interrupt, a kill or a full disk at any moment leaves `path` unchanged. The folder is created if it is
    missing. A path that is not a regular file, like /dev/stdout, is written directly.

    Raises:
        ArriveError: the file cannot be written.
    """
    try:
        path = Path(os.path.realpath(path))
        if _written_directly(path):
            yield path
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = _make_temporary(path, path.parent)
        try:
            yield temporary
            _finish(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise cannot_write(path, error) from error


def _written_directly(path: Path) -> bool:
    """Whether a path is something else than a regular file, like /dev/stdout. A folder raises an OSError."""
    if path.is_dir():
        raise IsADirectoryError("it is a folder")
    return path.exists() and not path.is_file()


def _make_temporary(path: Path, folder: Path) -> Path:
    """Create the temporary file for `path` in a folder."""
    handle, name = tempfile.mkstemp(dir=folder, prefix=f".{path.name}.", suffix=f"{TEMPORARY}{path.suffix}")
    os.close(handle)
    return Path(name)


def _finish(temporary: Path, path: Path) -> None:
    """Move a complete file to its place, with the permissions of the file that it replaces."""
    with temporary.open("rb") as file:
        os.fsync(file.fileno())
    os.chmod(temporary, path.stat().st_mode & 0o777 if path.exists() else 0o644)
    os.replace(temporary, path)


def check_writable(path: Path) -> None:
    """Check that a file can be written before the work for it is done. Nothing is changed.

    Raises:
        ArriveError: it cannot.
    """
    try:
        path = Path(os.path.realpath(path))
        if not _written_directly(path):
            _make_temporary(path, next(parent for parent in path.parents if parent.exists())).unlink()
    except OSError as error:
        raise cannot_write(path, error) from error
    except ValueError as error:
        raise ArriveError(f"cannot write {str(path)!r}: {error}") from error


def cannot_write(path: Path, error: OSError) -> ArriveError:
    """The error for a file that cannot be written."""
    return ArriveError(f"cannot write {path}: {error.strerror or error}. Free some space or choose another folder.")


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically; see `whole`."""
    with whole(path) as file:
        file.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file atomically, with what UTF-8 cannot express as escapes; see `whole`."""
    write_bytes(path, text.encode(errors="backslashreplace"))


def write_json(path: Path, content: Any) -> None:
    """Write data as JSON, atomically; see `whole`."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def check_readable(path: Path) -> None:
    """Check that a path is a regular file of limited size, not a device or a pipe.

    Raises:
        ArriveError: it is not.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        raise ArriveError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe"
        raise ArriveError(f"cannot read {path}: it is {kind}, not a file")
    if status.st_size > LARGEST_FILE:
        raise ArriveError(f"cannot read {path}: it has {status.st_size / 1e9:,.1f} GB, more than any file of arrive")


def read_bytes(path: Path) -> bytes:
    """A file's content; see `check_readable`."""
    check_readable(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise ArriveError(f"cannot read {path}: {error.strerror or error}") from error


def read_text(path: Path, encoding: str = "utf-8") -> str:
    """A UTF-8 file's text.

    Raises:
        ArriveError: there is no such file, or it is not text.
    """
    try:
        return read_bytes(path).decode(encoding)
    except UnicodeDecodeError as error:
        raise ArriveError(f"cannot read {path}: it is not UTF-8 text") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON file's content, which must be an object.

    Raises:
        ArriveError: it cannot be read or parsed; the message has the line of the fault.
    """
    try:
        content = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise ArriveError(f"cannot read {path}: it is not JSON ({error})") from error
    if not isinstance(content, dict):
        raise ArriveError(f"cannot read {path}: it must hold an object, {{...}}, not {type(content).__name__}")
    return content


def remove_unfinished(folder: Path) -> None:
    """Remove incomplete files that a killed process left. Call it only if no other process writes to the folder."""
    for path in filter(is_unfinished, list(folder.iterdir())):
        path.unlink(missing_ok=True)


def is_unfinished(path: Path) -> bool:
    """Whether this is a temporary file that was not complete."""
    return path.name.startswith(".") and TEMPORARY in path.name
