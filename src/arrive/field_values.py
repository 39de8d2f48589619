"""Values of configurations: conversion to and from plain data, and changes by name."""

import dataclasses
import difflib
import json
from typing import Any, get_args, get_origin

from arrive.errors import ArriveError, unknown_name
from arrive.fields import hints_of, rows, split_range


def to_dict(config: Any) -> dict[str, Any]:
    """The configuration as plain JSON data."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def from_dict(kind: type, data: dict[str, Any], where: str = "") -> Any:
    """Rebuild a configuration dataclass from `to_dict` data.

    Raises:
        ArriveError: a field does not exist or has the wrong type; the message names it and lists the valid ones.
    """
    hints = hints_of(kind)
    for name in data:
        if name not in hints:
            raise unknown_name(f"field {where}{name}; in {where or 'the configuration'}", name, hints)
    return kind(**{name: _convert(hints[name], value, f"{where}{name}") for name, value in data.items()})


def override(config: Any, assignments: tuple[str, ...]) -> Any:
    """Change fields by `path=value`, e.g. `task.rewards.stall_cost=-2` or `ppo.hidden=[128,64]`.

    For a term with several fields, a single number sets its weight, or its noise.

    Raises:
        ArriveError: the assignment is malformed, or there is no such field.
    """
    data = to_dict(config)
    for assignment in assignments:
        path, sign, text = assignment.partition("=")
        if not sign:
            raise ArriveError(f"cannot read {assignment!r}: write PATH=VALUE, e.g. ppo.gamma=0.995")
        _assign(config, data, path.strip(), _parse(text))
    return from_dict(type(config), data)


def _assign(config: Any, data: dict[str, Any], path: str, value: Any) -> None:
    part = config
    *way, last = path.split(".")
    for key in way:
        if key not in data or not dataclasses.is_dataclass(getattr(part, key)):
            raise _no_field(config, part, path, key)
        part, data = getattr(part, key), data[key]
    if last not in data:
        raise _no_field(config, part, path, last)
    main = getattr(getattr(part, last), "MAIN", None)
    if main is None and dataclasses.is_dataclass(getattr(part, last)) and not isinstance(value, dict):
        raise ArriveError(f"{path} has fields of its own, it cannot be {value!r}")
    if main is None or isinstance(value, dict):
        data[last] = value
    else:
        data[last][main] = value


def _no_field(config: Any, part: Any, path: str, key: str) -> ArriveError:
    """The error for an unknown path. It lists the valid fields and suggests a similar path."""
    valid = [row.name for row in dataclasses.fields(part)] if dataclasses.is_dataclass(part) else []
    paths = [row.path for row in rows(config)]
    elsewhere = [known for known in paths if _words_of(key) <= _words_of(known)]
    if not elsewhere and difflib.get_close_matches(key, valid, n=1):
        return unknown_name(f"field {path}: no", key, valid)
    meant = max(elsewhere or paths, key=lambda known: _likeness(path, known))
    hint = f" Did you mean {meant}?" if elsewhere or _likeness(path, meant) > 0.5 else ""
    return ArriveError(
        f"unknown field {path}: no {key!r}.{hint} Valid: {', '.join(sorted(valid)) or 'nothing below it'}"
    )


def _words_of(path: str) -> set[str]:
    return set(path.replace(".", "_").split("_"))


def _likeness(path: str, known: str) -> float:
    """Similarity of two paths: the share of common words, plus a little for common letters."""
    first, second = _words_of(path), _words_of(known)
    letters = difflib.SequenceMatcher(None, path, known).ratio()
    return len(first & second) / len(first | second) + 0.25 * letters


def _parse(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):  # not JSON, a number with thousands of digits, or nested too deeply
        return {"True": True, "False": False}.get(text, text)


def _convert(hint: Any, value: Any, where: str) -> Any:
    hint, _ = split_range(hint)
    if isinstance(hint, type) and (kinds := vars(hint).get("kinds")):
        return _choose(kinds, value, where)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        if hasattr(hint, "MAIN") and not isinstance(value, dict):
            value = {hint.MAIN: value}
        if not isinstance(value, dict):
            raise ArriveError(f"{where} has fields of its own, it cannot be {value!r}")
        return from_dict(hint, value, f"{where}.")
    if get_origin(hint) is tuple:
        return _convert_tuple(hint, value, where)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        # A larger integer is no float, and out of every range.
        return float(min(max(value, -(10**300)), 10**300))
    if options := get_args(hint):
        if value not in options:
            raise unknown_name(f"value of {where}", str(value), map(str, options))
        return value
    if not isinstance(value, hint) or (hint is int and isinstance(value, bool)):
        raise ArriveError(f"{where} must be {hint.__name__}, not {value!r}")
    return value


def _choose(kinds: dict[str, type], value: Any, where: str) -> Any:
    """The dataclass that the `name` in the data selects."""
    if not isinstance(value, dict):
        raise ArriveError(f"{where} has fields of its own, it cannot be {value!r}")
    name = value.get("name")
    if not isinstance(name, str) or name not in kinds:
        raise unknown_name(where, str(name), kinds)
    try:
        return from_dict(kinds[name], value, f"{where}.")
    except ArriveError as error:
        raise ArriveError(f"{error} ({where} {name!r})") from None


def _convert_tuple(hint: Any, value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise ArriveError(f"{where} must be a list, not {value!r}")
    kinds = get_args(hint)
    if kinds[-1] is not Ellipsis and len(kinds) != len(value):
        raise ArriveError(f"{where} must have {len(kinds)} entries, not {len(value)}")
    kinds = (kinds[0],) * len(value) if kinds[-1] is Ellipsis else kinds
    return tuple(_convert(kind, item, where) for kind, item in zip(kinds, value, strict=True))
