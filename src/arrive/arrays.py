"""Arrays from NPZ files of others."""

import os
import zipfile
from pathlib import Path

import numpy as np

from arrive.errors import ArriveError
from arrive.files import check_readable
from arrive.room import check_room

END = b"PK\5\6"
"""A zip file's last record begins with this (APPNOTE.TXT, section 4.3.16)."""
END_BYTES = 22
"""Size of that record without its comment, which ends the file [bytes]."""


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Every array of an NPZ file by its name; nothing in it is executed.

    Raises:
        ArriveError: it cannot be read, or its arrays are larger than the memory that is free.
    """
    check_readable(path)
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
            file.seek(-END_BYTES - len(archive.comment), os.SEEK_END)
            if file.read(len(END)) != END:
                raise zipfile.BadZipFile("bytes follow the end of the archive")
        check_room(size, 2, "bytes of arrays", f"other arrays than those of {path}")
        with np.load(path, allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files}
        if foreign := [name for name, array in found.items() if not isinstance(array, np.ndarray)]:
            raise ValueError(f"{foreign[0]!r} is no array")
        return found
    except ArriveError:
        raise
    except Exception as error:  # whatever foreign bytes make zipfile and numpy raise
        raise ArriveError(f"cannot read {path}: it is damaged or no NPZ file of plain arrays ({error})") from error


def as_numbers(path: Path, name: str, array: np.ndarray, kind: type) -> np.ndarray:
    """An array of a file as one of floating point numbers.

    Raises:
        ArriveError: it holds something else.
    """
    if array.dtype.kind not in "fiu":
        raise ArriveError(f"{path}: {name} must be numbers, not {array.dtype}")
    return array.astype(kind)
