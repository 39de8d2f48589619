"""Registries of named parts, to which a user's module can add."""

from typing import TypeVar

from arrive.errors import ArriveError, unknown_name

Thing = TypeVar("Thing")


def add(kind: str, things: dict[str, Thing], name: str, thing: Thing) -> None:
    """Register a part under a new name.

    Raises:
        ArriveError: the name is taken or invalid.
    """
    if not name or not name.replace("_", "a").isalnum():
        raise ArriveError(f"{name!r} is not a valid {kind} name: use letters, digits and underscores")
    if name in things:
        raise ArriveError(f"a {kind} named {name!r} already exists: choose another name")
    things[name] = thing


def get(kind: str, things: dict[str, Thing], name: str) -> Thing:
    """The part with this name.

    Raises:
        ArriveError: there is none; the message lists the valid names.
    """
    if name not in things:
        raise ArriveError(f"{unknown_name(kind, name, things)}; add your own with --import FILE.py")
    return things[name]
