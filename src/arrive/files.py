"""Files that are written whole or not at all."""

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
"""Part of the names of files that are not complete yet: `.NAME.RANDOM.tmp` and the suffix of NAME."""
LARGEST_FILE = 2**32
"""Larger ones are refused instead of being read into memory [bytes]."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield a file to write in place of `path`, which it replaces once it is complete and on the disk.

    A failure, an interrupt, a kill or a full disk at any moment leaves what was at `path` as it was. The folder is made
    where there is none. What is no regular file, like /dev/stdout, is written directly.

    Raises:
        ArriveError: it cannot be written.
    """
    try:
        path = Path(os.path.realpath(path))
        if path.exists() and not path.is_file():
            if path.is_dir():
                raise IsADirectoryError("it is a folder")
            yield path
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=f"{TEMPORARY}{path.suffix}")
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            _finish(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise cannot_write(path, error) from error


def _finish(temporary: Path, path: Path) -> None:
    """Put a complete file in its place, with the permissions of the one that was there."""
    with temporary.open("rb") as file:
        os.fsync(file.fileno())
    os.chmod(temporary, path.stat().st_mode & 0o777 if path.exists() else 0o644)
    os.replace(temporary, path)


def cannot_write(path: Path, error: OSError) -> ArriveError:
    """The error for a file that cannot be written."""
    return ArriveError(f"cannot write {path}: {error.strerror or error}. Free some space or choose another folder.")


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all; see `whole`."""
    with whole(path) as file:
        file.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file whole or not at all; see `whole`."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: Any) -> None:
    """Write data as JSON, whole or not at all; see `whole`."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def check_readable(path: Path) -> None:
    """Make sure that a path leads to a file that can be read to its end: no device, no pipe, nothing without limits.

    Raises:
        ArriveError: it does not.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        raise ArriveError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe"
        raise ArriveError(f"cannot read {path}: it is {kind}, no file")
    if status.st_size > LARGEST_FILE:
        raise ArriveError(
            f"cannot read {path}: its {status.st_size / 1e9:,.1f} GB are more than any file of arrive has"
        )


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
        ArriveError: there is none, or it is no text.
    """
    try:
        return read_bytes(path).decode(encoding)
    except UnicodeDecodeError as error:
        raise ArriveError(f"cannot read {path}: it is not UTF-8 text") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON file's content, which must be an object.

    Raises:
        ArriveError: it cannot be read, with the line where it goes wrong.
    """
    try:
        content = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise ArriveError(f"cannot read {path}: it is not JSON ({error})") from error
    if not isinstance(content, dict):
        raise ArriveError(f"cannot read {path}: it must hold an object, {{...}}, not {type(content).__name__}")
    return content


def remove_unfinished(folder: Path) -> None:
    """Remove what a killed process has left of files that it was writing; only for who alone writes to the folder."""
    for path in folder.glob(f".*{TEMPORARY}*"):
        path.unlink(missing_ok=True)
