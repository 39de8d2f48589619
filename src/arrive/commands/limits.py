"""Ranges of numbers and suffixes of files to write. An option's type declares them; they are checked before it runs."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from arrive.errors import ArriveError
from arrive.fields import SEED, Range

__all__ = ["COUNT", "INDEX", "JSON", "NETWORK", "PICTURE", "POSITIVE", "SEED", "Suffix", "check_limits"]

POSITIVE = Range(0.0, above=True)
COUNT = Range(1)
INDEX = Range(0)


@dataclass(frozen=True)
class Suffix:
    """Suffixes that a file to write may have, so that a slip does not replace a file of another kind."""

    suffixes: tuple[str, ...]

    def holds(self, path: Path) -> bool:
        """Whether a path has one of them, or is a device or a pipe."""
        return path.suffix in self.suffixes or (path.exists() and not path.is_file())

    def __str__(self) -> str:
        return f"a file that ends in {' or '.join(self.suffixes)}"


JSON = Suffix((".json",))
NETWORK = Suffix((".safetensors",))
PICTURE = Suffix((".png",))


def check_limits(command: Any) -> None:
    """Check all numbers and files to write of a command and of its subcommand.

    Raises:
        ArriveError: lists every option that is out of range, with its value and the range.
    """
    problems = list(_problems(command))
    if problems:
        raise ArriveError("; ".join(problems))


def _problems(command: Any) -> Iterator[str]:
    hints = get_type_hints(type(command), include_extras=True)
    for item in fields(command):
        value = getattr(command, item.name)
        if is_dataclass(value):
            yield from _problems(value)
        values = value if isinstance(value, tuple) else (value,)
        for limit in _limits(hints[item.name]):
            wrong = [one for one in values if one is not None and not limit.holds(one)]
            if wrong:
                yield f"--{item.name.replace('_', '-')} must be {limit}, not {' '.join(map(str, wrong))}"


def _limits(hint: Any) -> list[Range | Suffix]:
    return (
        [extra for extra in get_args(hint)[1:] if isinstance(extra, Range | Suffix)]
        if get_origin(hint) is Annotated
        else []
    )
