"""`arrive list`: the names that commands accept."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from arrive.commands.settings import print_config
from arrive.errors import ArriveError, unknown_name
from arrive.learning.rundir import read_config
from arrive.policies import DIFFICULTY_NAME, SHIPPED, shipped_names
from arrive.policies.solved import amounts, solved_beside
from arrive.presets import PRESETS
from arrive.robots import ROBOTS
from arrive.task.final import PositionConfig
from arrive.task.registry import TASKS
from arrive.task.rewards import functions
from arrive.terrain import FAMILIES, Family

if TYPE_CHECKING:
    from arrive.commands.options import List


CONFIG = "config"
"""Argument that lists the fields of a configuration instead."""


def list_names(command: List) -> None:
    """Print the names that commands accept."""
    names = {
        "terrains": {f.name: _describe(f) for f in FAMILIES.values()},
        "presets": {name: _first_line(build) for name, build in PRESETS.items()},
        "robots": {name: robot.description for name, robot in ROBOTS.items()},
        "tasks": {name: _first_line(task) for name, task in TASKS.items()},
        "rewards": {
            name: _first_line(function)
            for task in TASKS.values()
            for name, function in functions(task.Config().rewards).items()
        },
        "policies": {name: _ability(name) for name in shipped_names()},
    }
    if command.what == CONFIG:
        print_config()
        return
    if command.what is not None and command.what not in names:
        raise unknown_name("list", command.what, [*names, CONFIG])
    for kind in [command.what] if command.what else names:
        table = Table(title=kind, title_justify="left", show_header=False, box=None)
        for name, description in names[kind].items():
            table.add_row(name, escape(description))
        Console().print(table)


def _describe(family: Family) -> str:
    if family.lowest == family.highest:
        return family.description
    return f"{family.description} ({family.parameter} {family.lowest:g} to {family.highest:g} {family.unit})"


def _ability(policy: str) -> str:
    """What a shipped policy solves according to its evaluation, and what it was trained for."""
    config, _ = read_config(SHIPPED / policy)
    moving = isinstance(config.task, PositionConfig) and config.task.retarget_s > 0.0
    stick = " with moving targets, for a joystick" if moving else ""
    trained = f"{config.robot}, trained on {', '.join(config.terrain.families)}{stick}"
    if not (SHIPPED / policy / DIFFICULTY_NAME).is_file():
        return f"not evaluated; {trained}"
    try:
        solved = amounts(solved_beside(SHIPPED / policy))
    except ArriveError as error:
        return f"{error} {trained}"
    return f"solves {', '.join(solved) or 'nothing'} in 95 % of the episodes; {trained}"


def _first_line(thing: object) -> str:
    return (thing.__doc__ or "").strip().splitlines()[0]
