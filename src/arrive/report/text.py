"""Texts from files in charts and in Markdown, shown as they are: nothing in them is markup."""

import re

from arrive.errors import shown

SPECIAL = re.compile(r"[\\`*\[\]<>|&!~#$@]|(?<![^\W_])_|_(?![^\W_])|(?<=www)\.|:(?=//)", re.IGNORECASE)
"""What Markdown, or GitHub's form of it, may take for markup. An underscore within a word is none."""
FENCE = 3
"""Fewest backticks around a block of code."""


def plain(text: str) -> str:
    """A text for a chart: a dollar sign starts no formula."""
    return shown(text).replace("$", r"\$")


def markdown(text: str) -> str:
    """A text for a paragraph, a heading or a table of Markdown."""
    return SPECIAL.sub(lambda found: f"\\{found[0]}", shown(text))


def inline_code(text: str) -> str:
    """A text as code within a paragraph of Markdown."""
    text = shown(text)
    fence, space = "`" * (_longest_run(text) + 1), " " if "`" in text else ""
    return f"{fence}{space}{text}{space}{fence}"


def code_block(text: str, language: str) -> str:
    """A text of one or more lines as a block of code in Markdown."""
    fence = "`" * max(FENCE, _longest_run(text) + 1)
    lines = "\n".join(shown(line) for line in text.split("\n"))
    return f"{fence}{language}\n{lines}\n{fence}"


def _longest_run(text: str) -> int:
    """Length of the longest run of backticks."""
    return max(map(len, re.findall("`+", text)), default=0)
