"""Ranges of numbers and suffixes of files to write. An option's type declares them; they are checked before it runs."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from arrive.errors import ArriveError
from arrive.fields import SEED, Range
from arrive.files import check_writable

__all__ = [
    "COUNT",
    "FIGURE",
    "FITTED",
    "INDEX",
    "JSON",
    "NETWORK",
    "PAGE",
    "PICTURE",
    "POSITIVE",
    "SEED",
    "Suffix",
    "check_limits",
    "check_outputs",
]

POSITIVE = Range(0.0, above=True)
COUNT = Range(1)
INDEX = Range(0)


@dataclass(frozen=True)
class Suffix:
    """Suffixes that a file to write may have, so that a slip does not replace a file of another kind."""

    suffixes: tuple[str, ...]
    beside: str = ""
    """Suffix of a second file that is written beside it under the same name."""

    def holds(self, path: Path) -> bool:
        """Whether a path has one of them, or is a device or a pipe."""
        return path.suffix in self.suffixes or (path.exists() and not path.is_file())

    def files(self, path: Path) -> tuple[Path, ...]:
        """All files that are written."""
        return (path, path.with_suffix(self.beside)) if self.beside else (path,)

    def __str__(self) -> str:
        return f"a file that ends in {' or '.join(self.suffixes)}"


RESULT = ".json"
JSON = Suffix((RESULT,))
FIGURE = Suffix((RESULT,), beside=".png")
"""A result with its picture."""
PAGE = Suffix((".html", ".htm"), beside=RESULT)
NETWORK = Suffix((".safetensors",))
FITTED = Suffix((".safetensors",), beside=".png")
PICTURE = Suffix((".png",))


def check_limits(command: Any) -> None:
    """Check all numbers and the suffixes of all files to write, of a command and of its subcommand.

    Raises:
        ArriveError: lists every option that is out of range, with its value and the range.
    """
    problems = []
    for option in options_of(command):
        wrong = [one for one in option.values if not option.limit.holds(one)]
        if wrong:
            problems.append(f"{option.flag} must be {option.limit}, not {' '.join(map(str, wrong))}")
    if problems:
        raise ArriveError("; ".join(problems))


def check_outputs(command: Any) -> None:
    """Check all files to write, before the work: that they can be written, and that none is replaced by accident.

    A file that exists is replaced with --force alone. The result of a measurement, and what lies beside it, are checked
    by the command itself, which replaces shorter measurements of its own kind; see `keep_longer`.

    Raises:
        ArriveError: a file cannot be written or exists.
    """
    for option in options_of(command):
        if isinstance(option.limit, Suffix):
            for path in option.values:
                _check_output(option.limit.files(path), getattr(option.command, "force", False))


def _check_output(files: tuple[Path, ...], force: bool) -> None:
    for file in files:
        check_writable(file)
    there = [file for file in files if file.is_file()]
    if there and not force and not any(file.suffix == RESULT for file in there):
        raise ArriveError(f"{there[0]} exists; give --force to replace it, or name another file")


@dataclass(frozen=True)
class Option:
    """An option that was given or has a default, with a limit of its values."""

    command: Any
    """The command or subcommand that has it."""
    flag: str
    values: tuple[Any, ...]
    limit: Range | Suffix


def options_of(command: Any) -> Iterator[Option]:
    """The options of a command and of its subcommand that have limits."""
    hints = get_type_hints(type(command), include_extras=True)
    for item in fields(command):
        value = getattr(command, item.name)
        if is_dataclass(value):
            yield from options_of(value)
        values = tuple(one for one in (value if isinstance(value, tuple) else (value,)) if one is not None)
        for limit in _limits(hints[item.name]):
            yield Option(command, f"--{item.name.replace('_', '-')}", values, limit)


def _limits(hint: Any) -> list[Range | Suffix]:
    return (
        [extra for extra in get_args(hint)[1:] if isinstance(extra, Range | Suffix)]
        if get_origin(hint) is Annotated
        else []
    )
