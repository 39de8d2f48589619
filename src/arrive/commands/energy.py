"""`arrive energy`: energy consumption of walking."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import torch
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from arrive.commands.files import write_result
from arrive.commands.policies import read_policy
from arrive.commands.results import keep_longer
from arrive.commands.threads import use_threads
from arrive.errors import ArriveError
from arrive.evaluation.energy import NAME, check_energy_arguments, energy_content, measure_energy
from arrive.evaluation.walking import check_command, slower_words
from arrive.files import whole
from arrive.learning.policy import Policy
from arrive.report.energy_chart import energy_figure

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from arrive.commands.options import Energy


def energy(command: Energy) -> None:
    """Let policies walk at each speed, print the energy used, and write the JSON file and figure 4."""
    check_energy_arguments(command.speeds, command.robots, command.distance)
    # As in `eval`: small networks gain nothing from torch's threads.
    threads = use_threads(command.threads)
    torch.set_num_threads(1)
    policies = load_policies((command.policy, *command.others))
    for policy in policies:
        check_command(policy)
    effort = len(policies) * len(command.speeds) * command.robots * command.distance
    keep_longer(command.json, NAME, effort, command.force)
    measured = []
    with Progress(transient=True) as bar:
        for policy in policies:
            measured.append(
                measure_energy(
                    policy,
                    command.speeds,
                    command.robots,
                    command.distance,
                    command.seed,
                    threads,
                    shown_on(bar, f"{policy.name}: robot metres"),
                )
            )
    for content in measured:
        print_energy(content)
    say_slower(policies, command.speeds)
    result = energy_content(measured, command.robots, command.distance, command.seed)
    write_result(command.json, result)
    picture = command.json.with_suffix(".png")
    with whole(picture) as file:
        energy_figure(result).savefig(file, format="png", dpi=110)
    print(f"picture: {picture}")


def shown_on(bar: Progress, words: str) -> Callable[[int, int], None]:
    """What shows how far a measurement is, as one more task of the bar."""
    task = bar.add_task(words, total=None)
    return lambda done, total: bar.update(task, completed=done, total=total)


def load_policies(paths: tuple[Path, ...]) -> list[Policy]:
    """Read policies of different names on the CPU.

    Raises:
        ArriveError: one cannot be read, or two have the same name.
    """
    policies = [read_policy(path) for path in paths]
    names = [policy.name for policy in policies]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ArriveError(f"two policies are called {', '.join(repeated)}; each needs its own name")
    return policies


def say_slower(policies: Sequence[Policy], speeds: Sequence[float]) -> None:
    """Print a line for each policy that was measured at another speed than it was asked for."""
    for policy in policies:
        if words := slower_words(policy, speeds):
            print(words)


def print_energy(content: dict[str, Any]) -> None:
    """Print one policy's results as a table."""
    robots = content["speeds"][0]["robots"]
    title = f"{content['name']} ({content['task']}), {robots} robots a speed"
    table = narrow_table(
        title, ("given", "m/s", "Στ² [N²m²s/m]", "W+ [J/m]", "|W| [J/m]", "CoT", "time [s]", "fell", "stood")
    )
    for row in content["speeds"]:
        figures = ("speed", "torque_sq", "positive_work", "absolute_work", "cost_of_transport", "time_s")
        table.add_row(
            f"{row['told_m_s']:.3g}",
            *(with_interval(row[name]) for name in figures),
            str(row["fell"]),
            str(row["stood"]),
        )
    Console().print(table)


def narrow_table(title: str, columns: Sequence[str]) -> Table:
    """A table without lines that fits into 80 columns of a terminal where it can, and else breaks its cells."""
    table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0), header_style="dim")
    for column in columns:
        table.add_column(Text(column), overflow="fold")
    return table


def with_interval(figure: list[float] | None) -> str:
    """A value and half of its 95 % interval, such as "1.31±0.04", with as many digits as the interval needs."""
    if figure is None:
        return "-"
    value, low, high = figure
    half = (high - low) / 2
    digits = max(1 - math.floor(math.log10(half)), 0) if half > 0 else 3
    return f"{value:.{digits}f}±{half:.{digits}f}"
