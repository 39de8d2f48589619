"""Errors that the user can act on. The command line prints their message without a traceback."""

import difflib
from collections.abc import Iterable

LONGEST_NAME, LONGEST_FAULT = 200, 500
"""Longest name and longest description of a fault that an error shows in full [characters]."""


class ArriveError(Exception):
    """A problem that the user can solve. The message says what is wrong and what to do."""


class Interrupted(ArriveError):
    """Ctrl-C or `kill` ended a command before its work was done. The message says how to go on."""


def shown(text: str) -> str:
    """A text in one line, with what cannot be written or seen, such as terminal commands, as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def brief(text: str) -> str:
    """The beginning of a text, because values in files may be long."""
    return text if len(text) <= LONGEST_FAULT else f"{text[:LONGEST_FAULT]}..."


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> ArriveError:
    """The error for an unknown name. It lists the valid names and suggests a similar one."""
    names = sorted(valid)
    close = difflib.get_close_matches(name, names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    return ArriveError(f"unknown {kind} {name!r:.{LONGEST_NAME}}.{hint} Valid: {', '.join(names)}")
