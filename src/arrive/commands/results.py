"""Results that are not lost to shorter ones."""

from pathlib import Path
from typing import Any

from arrive.errors import ArriveError
from arrive.files import read_json


def keep_longer(path: Path, effort: float, force: bool) -> None:
    """Refuse to measure what would replace the result of a longer measurement.

    Args:
        effort: of what is about to be measured, as `effort_of` counts it.
        force: replace it all the same.

    Raises:
        ArriveError: what is at `path` took longer.
    """
    if force or not path.is_file():
        return
    before = effort_of(read_json(path))
    if effort < before:
        raise ArriveError(
            f"{path} holds a longer measurement ({before:,.0f} against {effort:,.0f} episodes or metres); "
            "give --force to replace it, or --json for another file"
        )


def effort_of(content: dict[str, Any]) -> float:
    """Episodes behind a result of `eval`, robot metres or seconds behind one of `energy` or `gait`; 0 of others."""
    try:
        if "effort" in content["protocol"]:
            return float(content["protocol"]["effort"])
        return sum(level["episodes"] for family in content["families"].values() for level in family["levels"])
    except (KeyError, TypeError, ValueError, AttributeError):
        return 0.0
