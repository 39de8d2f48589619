"""Things by name, to which a user's module can add."""

from typing import TypeVar

from arrive.errors import ArriveError, unknown_name

Thing = TypeVar("Thing")


def add(kind: str, things: dict[str, Thing], name: str, thing: Thing) -> None:
    """Add a thing under a name that is not taken.

    Raises:
        ArriveError: the name is taken, or is none.
    """
    if not name or not name.replace("_", "a").isalnum():
        raise ArriveError(f"{name!r} is no name of a {kind}: letters, digits and underscores make one")
    if name in things:
        raise ArriveError(f"there is a {kind} {name!r} already: choose another name")
    things[name] = thing


def get(kind: str, things: dict[str, Thing], name: str) -> Thing:
    """The thing of that name.

    Raises:
        ArriveError: there is none; the message lists the valid names.
    """
    if name not in things:
        raise ArriveError(f"{unknown_name(kind, name, things)}; one of your own comes with --import FILE.py")
    return things[name]
