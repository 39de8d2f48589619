"""Texts from files as charts can show them."""

from arrive.errors import shown


def plain(text: str) -> str:
    """A text for a chart as it is: a dollar sign starts no formula."""
    return shown(text).replace("$", r"\$")
