"""Protects results from being replaced by shorter measurements, and other files from being replaced at all."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from arrive.errors import ArriveError
from arrive.files import check_writable, read_json
from arrive.results.read import protocol_of


def keep_longer(path: Path, protocol: str, effort: float, force: bool) -> None:
    """Check that a new measurement would not replace the result of a longer one, or another file.

    Args:
        protocol: name of the new measurement's protocol.
        effort: size of the new measurement, in the unit of `effort_of`.
        force: replace the file anyway.

    Raises:
        ArriveError: the result at `path` is from a longer measurement, or the file holds something else.
    """
    content = keep_others(path, lambda found: protocol_of(found) == protocol, force)
    before = effort_of(content)
    if effort < before:
        raise ArriveError(
            f"{path} holds a longer measurement ({before:,.0f} against {effort:,.0f} episodes or metres); "
            "give --force to replace it, or name another file"
        )


def keep_others(path: Path, known: Callable[[dict[str, Any]], bool], force: bool) -> dict[str, Any]:
    """Check that a new result would not replace a file of another kind.

    Args:
        known: tells a result of this kind by its content.
        force: replace the file anyway.

    Returns:
        The content that will be replaced; empty if there is no file, or with `force`.

    Raises:
        ArriveError: the file at `path` holds something else, or cannot be written.
    """
    check_writable(path)
    if force or not path.is_file():
        return {}
    try:
        content = read_json(path)
    except ArriveError:
        content = {}
    if not known(content):
        raise ArriveError(
            f"{path} holds something else than a result of this command; give --force to replace it, or name another "
            "file"
        )
    return content


def effort_of(content: dict[str, Any]) -> float:
    """Size of a measurement: episodes of `eval`, robot metres of `energy`, robot seconds of `gait`, otherwise 0."""
    try:
        if "effort" in content["protocol"]:
            return float(content["protocol"]["effort"])
        return sum(level["episodes"] for family in content["families"].values() for level in family["levels"])
    except (KeyError, TypeError, ValueError, AttributeError):
        return 0.0
