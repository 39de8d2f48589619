"""Results that commands write."""

import json
from pathlib import Path
from typing import Any

from arrive.errors import ArriveError


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a result, making its folder, and say where it is.

    Raises:
        ArriveError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=2) + "\n")
    except OSError as error:
        raise ArriveError(f"cannot write {path}: {error}") from error
    print(f"result: {path}")
