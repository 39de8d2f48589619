"""Texts from files as charts and pages can show them."""


def plain(text: str) -> str:
    """A text for a chart as it is: a dollar sign starts no formula."""
    return shown(text).replace("$", r"\$")


def shown(text: str) -> str:
    """A text with what cannot be written or seen, such as half characters and control characters, as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
