"""Result files of commands."""

from pathlib import Path
from typing import Any

from arrive import files


def write_result(path: Path, content: dict[str, Any]) -> None:
    """Write a result, creating its folder if needed, and print its path.

    Raises:
        ArriveError: the file cannot be written.
    """
    files.write_json(path, content)
    print(f"result: {path}")
