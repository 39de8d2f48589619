"""`arrive gait`: gaits of policies."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from rich.console import Console
from rich.progress import Progress

from arrive.commands.energy import load_policies, narrow_table, say_slower, shown_on, with_interval
from arrive.commands.files import write_result
from arrive.commands.results import keep_longer
from arrive.commands.threads import use_threads
from arrive.evaluation.gait import NAME, check_gait_arguments, gait_content, measure_gait
from arrive.evaluation.walking import Heading, check_command
from arrive.files import whole
from arrive.report.gait_chart import gait_figure

if TYPE_CHECKING:
    from arrive.commands.options import Gait


def gait(command: Gait) -> None:
    """Let policies walk steadily, print their gaits, and write the JSON file and figure 5."""
    commands = [Heading(speed, direction) for speed in command.speeds for direction in command.directions]
    check_gait_arguments(commands, command.robots, command.seconds)
    threads = use_threads(command.threads)
    torch.set_num_threads(1)
    policies = load_policies((command.policy, *command.others))
    for policy in policies:
        check_command(policy, commands)
    keep_longer(command.json, NAME, len(policies) * len(commands) * command.robots * command.seconds, command.force)
    measured = []
    with Progress(transient=True) as bar:
        for policy in policies:
            measured.append(
                measure_gait(
                    policy,
                    commands,
                    command.robots,
                    command.seconds,
                    command.seed,
                    threads,
                    shown_on(bar, f"{policy.name}: policy steps"),
                )
            )
    for content in measured:
        print_gait(content)
    say_slower(policies, command.speeds)
    result = gait_content(measured, command.robots, command.seconds, command.seed)
    write_result(command.json, result)
    picture = command.json.with_suffix(".png")
    with whole(picture) as file:
        gait_figure(result).savefig(file, format="png", dpi=110)
    print(f"picture: {picture}")


def print_gait(content: dict[str, Any]) -> None:
    """Print the gaits of one policy as a table; phases are shares of a stride."""
    feet = content["feet"]
    phases = f"{' '.join(feet)} [%]"
    columns = ("given", "gait", "m/s", "Hz", "stride [m]", "duty", phases, "travel", "fell")
    table = narrow_table(f"{content['name']} ({content['task']})", columns)
    for row in content["gaits"]:
        direction = f" {row['direction_deg']:+g}°" if row["direction_deg"] else ""
        told = f"{row['told_m_s']:.3g}{direction}"
        if row["gait"] is None:
            table.add_row(told, "does not walk", *[""] * 6, str(row["fell"]))
            continue
        duty = sum(value for value, _, _ in row["duty"]) / len(feet)
        table.add_row(
            told,
            row["gait"],
            *(with_interval(row[name]) for name in ("speed_m_s", "stride_frequency_hz", "stride_length_m")),
            f"{duty:.2f}",
            " ".join(f"{100 * phase:.0f}".rjust(len(foot)) for foot, phase in zip(feet, row["phase"], strict=True)),
            f"{row['travel_deg']:+.0f}°",
            str(row["fell"]),
        )
    Console().print(table)
