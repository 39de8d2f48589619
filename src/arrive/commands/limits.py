"""Ranges of numeric options. They are declared in each option's type and checked before a command runs."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from arrive.errors import ArriveError
from arrive.fields import SEED, Range

__all__ = ["COUNT", "INDEX", "POSITIVE", "SEED", "check_limits"]

POSITIVE = Range(0.0, above=True)
COUNT = Range(1)
INDEX = Range(0)


def check_limits(command: Any) -> None:
    """Check all numbers of a command and of its subcommand.

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


def _limits(hint: Any) -> list[Range]:
    return [extra for extra in get_args(hint)[1:] if isinstance(extra, Range)] if get_origin(hint) is Annotated else []
