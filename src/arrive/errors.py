"""Errors that a person can act on; the command line prints their message without a traceback."""

import difflib
from collections.abc import Iterable


class ArriveError(Exception):
    """A problem the user can solve; its message says what is wrong and what to do."""


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> ArriveError:
    """The error for a name that does not exist: it lists the valid ones and guesses what was meant."""
    names = sorted(valid)
    close = difflib.get_close_matches(name, names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    return ArriveError(f"unknown {kind} {name!r}.{hint} Valid: {', '.join(names)}")
