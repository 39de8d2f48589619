"""Writes docs/configuration.md and src/arrive/commands/known.json from the code that defines what they list.

python scripts/config_reference.py           # writes
python scripts/config_reference.py --check   # exit status 1 where it is not up to date
"""

import itertools
import json
from collections.abc import Iterable
from pathlib import Path

from pages import write_or_check

from arrive.commands.known import FILE, collect
from arrive.fields import FieldInfo, rows
from arrive.presets import PRESETS
from arrive.task.registry import TASKS

PAGE = Path(__file__).parent.parent / "docs" / "configuration.md"
HEAD = """# Configuration

Made from the code by `python scripts/config_reference.py`; change the docstrings, not this page.

`arrive train TERRAINS --preset NAME --set FIELD=VALUE ...` changes any field. `config.json` in the run's folder has all
of them as they were. Where presets differ, their values stand in this order: {presets}.
"""
OTHER = """
## `task`, with `--task {name}`

{description} {new}
"""


def page() -> str:
    """The page as Markdown."""
    presets = {name: list(rows(build())) for name, build in PRESETS.items()}
    configs = [build() for build in PRESETS.values()]
    parts = [HEAD.format(presets=", ".join(f"`{name}`" for name in presets))]
    for section, group in itertools.groupby(zip(*presets.values(), strict=True), lambda same: section_of(same[0])):
        parts.append(f"\n## {section}\n\n" + table([(same[0], values(same)) for same in group]))
    first = configs[0].task.name
    known = {row.path for row in presets[next(iter(presets))]}
    for name, task in TASKS.items():
        if name == first:
            continue
        config = task.from_preset(configs[0].task)
        new = [row for row in rows(config, "task.") if row.path not in known]
        words = f"Fields that `{first}` does not have:" if new else f"It has no fields that `{first}` does not have."
        parts.append(OTHER.format(name=name, description=(task.__doc__ or "").strip().splitlines()[0], new=words))
        if new:
            parts.append("\n" + table([(row, values([row])) for row in new]))
    return "".join(parts)


def listing() -> str:
    """What `arrive list` and the help of `arrive train` print without loading the code."""
    return json.dumps(collect(), indent=1) + "\n"


def section_of(row: FieldInfo) -> str:
    """The heading of a field's section."""
    section, dot, _ = row.path.partition(".")
    return f"`{section}`" if dot else "The run"


def values(same: Iterable[FieldInfo]) -> str:
    """The value of one field in every preset; a single one if they agree."""
    shown = [f"`{json.dumps(row.value)}`" for row in same]
    return shown[0] if len(set(shown)) == 1 else ", ".join(shown)


def table(fields: list[tuple[FieldInfo, str]]) -> str:
    """A table with field, value, unit, range and meaning."""
    lines = ["| field | value | unit | range | meaning |", "|---|---|---|---|---|"]
    for row, value in fields:
        cells = (f"`{row.path}`", value, row.unit, row.range, row.meaning)
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    write_or_check({PAGE: page(), FILE: listing()})
