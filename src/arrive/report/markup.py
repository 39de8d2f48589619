"""Parts shared by the sections of the page: names of policies, charts, and notes on missing results."""

import base64
import html
import shlex
from collections.abc import Callable, Sequence

from matplotlib.figure import Figure

from arrive.report.figure import COLUMNS, color_of, svg_text
from arrive.report.records import SYMBOLS

NARROW = "max-width: 700px"
"""Screens of phones, on which charts have one column."""


def symbol(task: str) -> str:
    """The paper's symbol of a task, in its colour."""
    letter, _, index = SYMBOLS.get(task, task).partition("_")
    subscript = f"<sub>{index}</sub>" if index else ""
    return f'<b style="color:{color_of(task)}">{html.escape(letter)}{subscript}</b>'


def label(task: str, name: str) -> str:
    """A policy's symbol and name."""
    return f"{symbol(task)} ({html.escape(name)})"


def code(command: str) -> str:
    """A command as it is typed."""
    return f"<code>{html.escape(command)}</code>"


def command_line(*words: object) -> str:
    """An `arrive` command, quoted where a shell needs it."""
    return shlex.join(["arrive", *map(str, words)])


def missing(what: str, *commands: str) -> str:
    """The note in a section without data."""
    return f"<p class=missing>{what} To make it: {' then '.join(map(code, commands))}</p>"


def chart(draw: Callable[[int], Figure], alternative: str, columns: int = COLUMNS) -> str:
    """A chart of several panels: side by side on a wide screen, below each other on a phone.

    Args:
        draw: makes the figure with so many columns of panels.
    """
    wide, narrow = (_data_uri(svg_text(draw(count)).encode()) for count in (columns, 1))
    return (
        f'<picture><source media="({NARROW})" srcset="{narrow}"><img alt="{html.escape(alternative)}" src="{wide}">'
        "</picture>"
    )


def _data_uri(svg: bytes) -> str:
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of HTML cells that can be moved sideways where the screen is too narrow for it."""
    lines = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<div class=wide><table><tr>{''.join(f'<th>{cell}</th>' for cell in head)}</tr>{lines}</table></div>"
