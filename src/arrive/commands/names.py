"""`arrive list`: the names that commands accept."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from arrive.commands.known import known
from arrive.errors import ArriveError, unknown_name
from arrive.files import read_json
from arrive.policies import CONFIG_NAME, DIFFICULTY_NAME, SHIPPED, shipped_names
from arrive.policies.solved import amounts, solved_beside
from arrive.results.read import check_result
from arrive.robots import ROBOTS
from arrive.terrain import FAMILIES, Family
from arrive.terrain.ground import varies

if TYPE_CHECKING:
    from arrive.commands.options import List


CONFIG = "config"
"""Argument that lists the fields of a configuration instead."""


def list_names(command: List) -> None:
    """Print the names that commands accept."""
    code = known()
    if command.what == CONFIG:
        print(code[CONFIG], end="")
        return
    names = {
        "terrains": {f.name: _describe(f) for f in FAMILIES.values()},
        "presets": code["presets"],
        "robots": {name: robot.description for name, robot in ROBOTS.items()},
        "tasks": code["tasks"],
        "rewards": code["rewards"],
        "policies": {name: _ability(name) for name in shipped_names()},
    }
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
    path = SHIPPED / policy / CONFIG_NAME
    record = read_json(path)
    check_result(record, "shipped", path)
    config = record["config"]
    stick = " with moving targets, for a joystick" if config["task"].get("retarget_s") else ""
    trained = f"{config['robot']}, trained on {', '.join(config['terrain']['families'])}{stick}"
    if not (SHIPPED / policy / DIFFICULTY_NAME).is_file():
        return f"not evaluated; {trained}"
    try:
        solved = solved_beside(SHIPPED / policy)
    except ArriveError as error:
        return f"{error} {trained}"
    return f"solves {_up_to(solved)}; {trained}"


def _up_to(solved: dict[str, float]) -> str:
    """Solved terrains with the rule by which they count; see `max_at` in evaluation/difficulty.py."""
    values = amounts(solved)
    listed = [*(name for name in solved if not varies(FAMILIES[name])), *values]
    easier = " and everything easier" if values else ""
    return f"{', '.join(listed) or 'no terrain'}{easier} in 95 % of the episodes"
