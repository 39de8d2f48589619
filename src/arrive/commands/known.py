"""Presets, tasks, rewards and fields of the configuration, without loading the code that defines them.

That code takes seconds to load, because it needs torch. So `known.json` has what it defines.
`scripts/config_reference.py` writes it, and a test fails if it is not up to date.
"""

import json
import sys
from pathlib import Path
from typing import Any

FILE = Path(__file__).parent / "known.json"
DEFINES = "arrive.config"
"""Module without which nothing can be added to the presets, tasks and rewards."""


def known() -> dict[str, Any]:
    """Descriptions of `presets`, `tasks` and `rewards` by name, and `config`: all fields, as a text.

    Additions by the user's own modules are included: such a module has loaded the code.
    """
    if DEFINES in sys.modules:
        return collect()
    content: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return content


def collect() -> dict[str, Any]:
    """The same from the code."""
    # Imported here because this takes seconds.
    from arrive.commands.settings import config_text
    from arrive.presets import PRESETS
    from arrive.task.registry import TASKS
    from arrive.task.rewards import functions

    rewards = {
        name: _first_line(function)
        for task in TASKS.values()
        for name, function in functions(task.Config().rewards).items()
    }
    return {
        "presets": {name: _first_line(build) for name, build in PRESETS.items()},
        "tasks": {name: _first_line(task) for name, task in TASKS.items()},
        "rewards": rewards,
        "config": config_text(),
    }


def _first_line(thing: object) -> str:
    return (thing.__doc__ or "").strip().splitlines()[0]
