"""Checks data from JSON against types. The first value that does not fit is an error with its place in the file.

msgspec would leave out the names of keys from the place (`families[...].levels[2]`), and accept NaN without a range.

A type is a TypedDict, `list[T]` (at least one), `tuple[T, ...]` (any number), `tuple[A, B]` (exactly these), `dict[str,
T]`, `T | None`, `int`, `float`, `bool`, `str`, Any, or `Annotated` with a `Range`.
"""

import math
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

from arrive.errors import ArriveError
from arrive.fields import Range

ANY_NUMBER = Range(-1e15, 1e15)
"""The range of numbers without their own. NaN and infinity are never valid."""


def check_data(hint: Any, value: Any, where: str = "") -> None:
    """Check data against a type. Keys that the type does not name may hold any valid JSON.

    Args:
        where: place of the value in the file, such as "families.gap.levels[2]".

    Raises:
        ArriveError: a value does not fit; the message says where, and what would be valid.
    """
    hint, limits = _split(hint)
    origin = get_origin(hint)
    if hint is Any:
        return
    if is_typeddict(hint):
        _check_object(hint, value, where)
    elif origin in (Union, UnionType):
        _check_union(hint, value, where, limits)
    elif origin is dict:
        _expect(isinstance(value, dict), "an object, {...}", value, where)
        for name, item in value.items():
            check_data(get_args(hint)[1], item, _below(where, name))
    elif origin in (list, tuple):
        _check_list(hint, value, where)
    else:
        _check_plain(hint, limits, value, where)


def check_finite(value: Any, where: str = "") -> None:
    """Check that all numbers are finite, wherever they are.

    Raises:
        ArriveError: one is not; the message says where.
    """
    if isinstance(value, dict):
        for name, item in value.items():
            check_finite(item, _below(where, name))
    elif isinstance(value, list):
        for i, item in enumerate(value):
            check_finite(item, f"{where}[{i}]")
    elif isinstance(value, float):
        _expect(math.isfinite(value), "a finite number", value, where)


def _split(hint: Any) -> tuple[Any, Range]:
    """A type without its range, and the range."""
    if get_origin(hint) is NotRequired:
        hint = get_args(hint)[0]
    if get_origin(hint) is Annotated:
        base, *notes = get_args(hint)
        return base, next(note for note in notes if isinstance(note, Range))
    return hint, ANY_NUMBER


@cache
def _hints(hint: Any) -> dict[str, Any]:
    return get_type_hints(hint, include_extras=True)


def _below(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _check_object(hint: Any, value: Any, where: str) -> None:
    _expect(isinstance(value, dict), "an object, {...}", value, where)
    for name, own in _hints(hint).items():
        if name in value:
            check_data(own, value[name], _below(where, name))
        elif name in hint.__required_keys__:
            raise ArriveError(f"{_below(where, name)} is missing")


def _check_list(hint: Any, value: Any, where: str) -> None:
    kinds = get_args(hint)
    exactly = get_origin(hint) is tuple and kinds[-1] is not Ellipsis
    _expect(isinstance(value, list), f"a list of {len(kinds)} values" if exactly else "a list, [...]", value, where)
    if exactly:
        _expect(len(value) == len(kinds), f"a list of {len(kinds)} values", value, where)
    elif get_origin(hint) is list:
        _expect(bool(value), "a list of at least one value", value, where)
    for i, item in enumerate(value):
        check_data(kinds[i] if exactly else kinds[0], item, f"{where}[{i}]")


def _check_union(hint: Any, value: Any, where: str, limits: Range) -> None:
    if value is None and NoneType in get_args(hint):
        return
    (kind,) = (kind for kind in get_args(hint) if kind is not NoneType)
    check_data(Annotated[kind, limits] if kind in (int, float) else kind, value, where)


def _check_plain(kind: type, limits: Range, value: Any, where: str) -> None:
    if kind is bool:
        _expect(isinstance(value, bool), "true or false", value, where)
    elif kind is str:
        _expect(isinstance(value, str), "a text", value, where)
    else:
        number = isinstance(value, int) or (kind is float and isinstance(value, float))
        words = "an integer" if kind is int else "a number"
        fits = number and not isinstance(value, bool) and limits.holds(value)
        _expect(fits, f"{words}, {limits}" if limits != ANY_NUMBER else f"{words} below 1e15", value, where)


def _expect(holds: bool, must: str, value: Any, where: str) -> None:
    if not holds:
        raise ArriveError(f"{where or 'the file'} must be {must}, not {_shown(value)}")


def _shown(value: Any) -> str:
    """A value in a line, however long it is."""
    if isinstance(value, dict | list):
        kind = "an object" if isinstance(value, dict) else "a list"
        return f"{kind} of {len(value)} value{'' if len(value) == 1 else 's'}"
    text = ascii(value) if not isinstance(value, int) or abs(value) < 10**60 else "a number of more than 60 digits"
    return text if len(text) <= 60 else f"{text[:57]}..."
