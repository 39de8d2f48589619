"""Reads result files: whole and checked, or an error of one line."""

from pathlib import Path
from typing import Any

from arrive.errors import ArriveError
from arrive.files import read_json
from arrive.results.check import check_data, check_finite
from arrive.results.consistency import FORMATS


def read_result(path: Path, kind: str) -> dict[str, Any]:
    """A result file's content.

    Args:
        kind: one of `FORMATS`.

    Raises:
        ArriveError: it cannot be read, is the result of something else, or has a value that is missing or wrong; the
            message has the file and the place in it.
    """
    content = read_json(path)
    found = protocol_of(content)
    if found != kind:
        raise ArriveError(f"{path} holds no result of {kind!r}: its protocol.name is {found!a:.60}")
    check_result(content, kind, path)
    return content


def protocol_of(content: dict[str, Any]) -> Any:
    """What a result calls itself, None if the content is something else. It is not checked."""
    protocol = content.get("protocol")
    return protocol.get("name") if isinstance(protocol, dict) else None


def read_if_there(path: Path, kind: str) -> dict[str, Any] | None:
    """The same, or None where there is no such file."""
    return read_result(path, kind) if path.is_file() else None


def check_result(content: Any, kind: str, path: Path, remedy: str = "Measure again, or restore the file.") -> None:
    """Check what was read from a file.

    Args:
        remedy: what to do about a damaged file.

    Raises:
        ArriveError: a value is missing or wrong; the message has the file and the place in it.
    """
    hint, check = FORMATS[kind]
    try:
        check_finite(content)
        check_data(hint, content)
        check(content)
    except (ArriveError, RecursionError) as error:
        what = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise ArriveError(f"cannot read {path}: {what}. {remedy}") from error
