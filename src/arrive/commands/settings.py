"""`arrive list config`: every field of a configuration with its unit, default and range."""

import json
import textwrap
from collections.abc import Iterator
from typing import Any

from arrive.fields import FieldInfo, rows
from arrive.recipe import DEFAULT_PRESET, make_config
from arrive.task.registry import TASKS
from arrive.terrain import parse_families

WIDTH = 120
TASK = "task."


def config_text() -> str:
    """Every field: first those that all tasks share, then each task's own."""
    lines = [
        f"Fields for --set PATH=VALUE, with the defaults of the preset {DEFAULT_PRESET}.",
        "For a term with several parameters, a single number sets its weight, or its noise.\n",
    ]
    for heading, fields in sections():
        lines += [heading, *(_described(row) for row in fields), ""]
    return "\n".join(lines) + "\n"


def sections() -> Iterator[tuple[str, list[FieldInfo]]]:
    """Headings with rows: first the fields that all tasks share, then each task's own."""
    for index, name in enumerate(TASKS):
        everything = list(rows(make_config(parse_families("flat"), task=name)))
        if index == 0:
            yield "with any task:", [row for row in everything if not row.path.startswith(TASK)]
        yield f"with --task {name}:", [row for row in everything if row.path.startswith(TASK)]


def _described(row: FieldInfo) -> str:
    unit, limits = f" [{row.unit}]" if row.unit else "", f" ({row.range})" if row.range else ""
    head = f"  {row.path} = {_written(row.value)}{unit}{limits}"
    indent = " " * 6
    return "\n".join([head, *textwrap.wrap(row.meaning, WIDTH, initial_indent=indent, subsequent_indent=indent)])


def _written(value: Any) -> str:
    """A value as --set takes it."""
    return value if isinstance(value, str) else json.dumps(value)
