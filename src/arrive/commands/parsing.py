"""What tyro says in Python's words or in a frame of seven lines, said plainly."""

from typing import Any, get_args

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from arrive.errors import ArriveError, unknown_name

NUMBERS = ConstructorRegistry()
"""Reads numbers, with errors that say what a number looks like."""
KINDS = {int: "a whole number such as 8", float: "a number such as 0.5"}


@NUMBERS.primitive_rule
def _number(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """How an option that is an int or a float, or either of them or None, is read and shown."""
    kinds = [kind for kind in KINDS if info.type is kind or set(get_args(info.type)) == {kind, type(None)}]
    if not kinds:
        return None
    (kind,) = kinds
    optional = info.type is not kind

    def read(words: list[str]) -> int | float | None:
        if optional and words[0] == str(None):
            return None
        try:
            return kind(words[0])
        except ValueError:
            raise ValueError(f"{words[0]!r} is not {KINDS[kind]}") from None

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=kind.__name__.upper(),
        instance_from_str=read,
        is_instance=lambda value: (optional and value is None) or isinstance(value, int | kind),
        str_from_instance=lambda value: [str(value)],
    )


def subcommands(choice: Any) -> dict[str, type]:
    """The commands of a choice `Annotated[Train, subcommand("train")] | ...`, by name."""
    return {get_args(one)[1].name: get_args(one)[0] for one in get_args(choice)}


def unknown_command(words: list[str], choice: Any, of: str = "") -> ArriveError | None:
    """The error for a word in the place of a command that is none; otherwise None.

    Args:
        words: the arguments from that place on.
        of: the command whose subcommands these are.
    """
    names = subcommands(choice)
    if not words or words[0].startswith("-") or words[0] in names:
        return None
    return unknown_name(f"{of} command".strip(), words[0], names)
