"""Protects results from being replaced by shorter measurements, and other files from being replaced at all."""

from pathlib import Path
from typing import Any

from arrive.errors import ArriveError
from arrive.files import read_json


def keep_longer(path: Path, effort: float, force: bool) -> None:
    """Check that a new measurement would not replace the result of a longer one.

    Args:
        effort: size of the new measurement, in the unit of `effort_of`.
        force: replace the result anyway.

    Raises:
        ArriveError: the result at `path` is from a longer measurement, or the file holds no result at all.
    """
    if force or not path.is_file():
        return
    content = read_json(path)
    if "protocol" not in content:
        raise ArriveError(f"{path} holds something else than a result; give --json for another file")
    before = effort_of(content)
    if effort < before:
        raise ArriveError(
            f"{path} holds a longer measurement ({before:,.0f} against {effort:,.0f} episodes or metres); "
            "give --force to replace it, or --json for another file"
        )


def keep_others(path: Path, keys: tuple[str, ...], force: bool) -> None:
    """Check that a new result would not replace a file of another kind.

    Args:
        keys: keys by which a result of this kind is known; one is enough.
        force: replace the file anyway.

    Raises:
        ArriveError: the file at `path` holds something else.
    """
    if force or not path.is_file():
        return
    try:
        content = read_json(path)
    except ArriveError:
        content = {}
    if not any(key in content for key in keys):
        raise ArriveError(
            f"{path} holds something else than a result of this command; give --force to replace it, or --json for "
            "another file"
        )


def effort_of(content: dict[str, Any]) -> float:
    """Size of a measurement: episodes of `eval`, robot metres of `energy`, robot seconds of `gait`, otherwise 0."""
    try:
        if "effort" in content["protocol"]:
            return float(content["protocol"]["effort"])
        return sum(level["episodes"] for family in content["families"].values() for level in family["levels"])
    except (KeyError, TypeError, ValueError, AttributeError):
        return 0.0
