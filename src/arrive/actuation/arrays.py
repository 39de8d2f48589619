"""Arrays from NPZ files of others."""

import zipfile
from pathlib import Path

import numpy as np

from arrive.errors import ArriveError
from arrive.files import check_readable
from arrive.room import check_room


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Every array of an NPZ file by its name; nothing in it is executed.

    Raises:
        ArriveError: it cannot be read, or its arrays are larger than the memory that is free.
    """
    check_readable(path)
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        check_room(size, 2, "bytes of arrays", f"other arrays than those of {path}")
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
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
