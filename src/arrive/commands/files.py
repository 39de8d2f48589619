"""Results that commands write."""

from pathlib import Path
from typing import Any

from arrive import files


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a result, making its folder, and say where it is.

    Raises:
        ArriveError: it cannot be written.
    """
    files.write_json(path, content)
    print(f"result: {path}")
