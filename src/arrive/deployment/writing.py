"""Writes files whole or not at all."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from arrive.errors import ArriveError


def write_whole(path: Path, content: bytes, check: Callable[[Path], object] = lambda path: None) -> None:
    """Put a file in its place at once, so that a crash or a full disk leaves the one before as it was.

    Args:
        check: called with the finished file beside its place; what it raises keeps the file from going there.

    Raises:
        ArriveError: the folder cannot be written or the disk is full.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            check(temporary)
            temporary.chmod(0o644)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise ArriveError(f"cannot write {path}: {error}. Free some space or choose another folder.") from error
