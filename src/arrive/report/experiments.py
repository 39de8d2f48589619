"""The page's sections on figures 4 and 5, on stability and on the reward window, each with its origin."""

import html
import re
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from arrive.report.energy_chart import energy_figure
from arrive.report.gait_chart import gait_figure
from arrive.report.markup import chart, code, command_line, label, missing, symbol, table
from arrive.report.records import SYMBOLS, Measured, Run
from arrive.report.statements import energy_statements, gait_statements, stability_statements, successes
from arrive.report.training_charts import stability_figure, window_figure

MARKS = {"holds": "✓", "fails": "✗", "open": "?"}


@dataclass(frozen=True)
class Results:
    """Measurements outside the runs' folders; each None if there is none."""

    energy: dict[str, Any] | None = None
    """Of `arrive energy`."""
    gait: dict[str, Any] | None = None
    """Of `arrive gait`."""
    stability: dict[str, Any] | None = None
    """Of benchmarks/stability.py."""
    window: dict[str, Any] | None = None
    """Of benchmarks/time_window.py."""


FILES = {
    "energy": Path("energy.json"),
    "gait": Path("gait.json"),
    "stability": Path("runs/stability/stability.json"),
    "window": Path("runs/time_window/time_window.json"),
}
"""Where the commands write their results if they are not told otherwise."""


def energy_section(runs: Sequence[Run], content: dict[str, Any] | None) -> str:
    """Figure 4 of the paper."""
    head = "<h2 id=energy>What walking costs (figure 4)</h2>"
    if content is None:
        return head + missing("Not measured.", command_line("energy", *_walkers(runs)))
    protocol = content["protocol"]
    commanded = {task: html.escape(protocol["command"][task]) for task in SYMBOLS}
    note = (
        f"<p class=soft>{protocol['robots']} robots walk {protocol['way_m']:g} m of flat ground at each speed, with "
        f"sensor noise. {symbol('velocity')} gets {commanded['velocity']}; {symbol('final')} {commanded['final']}; "
        f"{symbol('continuous')} {commanded['continuous']}. Costs are those of {html.escape(protocol['counted'])}. "
        "Bars: 95 % intervals.</p>"
    )
    rows = [
        [label(policy.task, policy.name), f"{row['told_m_s']:.3g}"]
        + [_interval(row[name], digits) for name, digits in ENERGY_COLUMNS.values()]
        + [str(row["fell"]), str(row["stood"])]
        for policy in Measured.of(content)
        for row in policy.content["speeds"]
    ]
    figures = table(["policy", "command [m/s]", *ENERGY_COLUMNS, "fell", "stood"], rows)
    speeds = _told(content, "speeds", "told_m_s")
    options = ("--robots", protocol["robots"], "--distance", f"{protocol['way_m']:g}", "--seed", protocol["seed"])
    command = command_line("energy", *_names(content), "--speeds", *speeds, *options)
    return (
        head
        + note
        + statement_list(energy_statements(content))
        + chart(lambda columns: energy_figure(content, columns), "energy over speed")
        + f"<details><summary>All figures</summary>{figures}</details>"
        + _origin(command, content)
    )


ENERGY_COLUMNS = {
    "reached [m/s]": ("speed", 2),
    "torques² [N²m²s/m]": ("torque_sq", 0),
    "positive work [J/m]": ("positive_work", 0),
    "absolute work [J/m]": ("absolute_work", 0),
    "cost of transport": ("cost_of_transport", 2),
    "time [s]": ("time_s", 0),
}
"""Name and digits of each figure."""


def gait_section(runs: Sequence[Run], content: dict[str, Any] | None) -> str:
    """Figure 5 of the paper."""
    head = "<h2 id=gait>How the robots step (figure 5)</h2>"
    if content is None:
        return head + missing("Not measured.", command_line("gait", *_walkers(runs)))
    protocol = content["protocol"]
    note = (
        f"<p class=soft>{protocol['robots']} robots on flat ground, looked at for {protocol['seconds']:g} s after "
        f"{protocol['settle_s']:g} s of walking; bars show when each foot of a typical robot stands. Feet step "
        f"together whose phases differ by at most {protocol['together']:g} strides; a gait has no name where phases "
        "spread by more than its threshold.</p>"
    )
    rows = []
    for policy in Measured.of(content):
        for row in policy.content["gaits"]:
            cells = [label(policy.task, policy.name), f"{row['told_m_s']:.3g} m/s, {row['direction_deg']:g}°"]
            if row["gait"] is None:
                rows.append([*cells, "does not walk", *[""] * 6, str(row["fell"])])
                continue
            duty = " ".join(f"{value[0]:.2f}" for value in row["duty"])
            phases = " ".join(f"{value:.2f}" for value in row["phase"])
            motion = ("speed_m_s", 2), ("stride_frequency_hz", 2), ("stride_length_m", 2)
            figures = (_interval(row[name], digits) for name, digits in motion)
            travel = f"{row['travel_deg']:+.0f}°"
            rows.append([*cells, html.escape(row["gait"]), *figures, duty, phases, travel, str(row["fell"])])
    feet = html.escape(" ".join(content["policies"][0]["feet"]))
    columns = ["gait", "m/s", "Hz", "stride [m]", f"duty {feet}", f"phase {feet}", "travel", "fell"]
    speeds, directions = (_told(content, "gaits", name) for name in ("told_m_s", "direction_deg"))
    options = ("--seconds", f"{protocol['seconds']:g}", "--robots", protocol["robots"], "--seed", protocol["seed"])
    command = command_line("gait", *_names(content), "--speeds", *speeds, "--directions", *directions, *options)
    return (
        head
        + note
        + statement_list(gait_statements(content))
        + chart(lambda count: gait_figure(content, count), "footfalls")
        + f"<details><summary>All figures</summary>{table(['policy', 'command', *columns], rows)}</details>"
        + _origin(command, content)
    )


def stability_section(content: dict[str, Any] | None) -> str:
    """Effect of the paper's three changes for stability (its section II-E)."""
    head = "<h2 id=stability>Stability of training (section II-E)</h2>"
    if content is None:
        return head + missing("Not measured.", "python benchmarks/stability.py --samples 5e6")
    protocol = content["protocol"]
    note = (
        "<p class=soft>The paper takes 48 instead of 24 steps per iteration and episodes of 6 instead of 20 s, and "
        "does not bootstrap time-outs. Compared here: the preset "
        f"{html.escape(protocol['preset'])} as it is ({html.escape(next(iter(content['variants'].values())))}), with "
        "one of the three undone, and with all undone. A seed succeeds if its policy arrives in at least "
        f"{protocol['goal']:.0%} of {protocol['episodes']} episodes of the protocol on its terrain. Every run has "
        f"{protocol['samples'] / 1e6:g} M samples. Explained variance and loss of the value function are means over "
        "the last tenth of a run.</p>"
    )
    rows = []
    for ground in protocol["grounds"]:
        for name, words in content["variants"].items():
            runs = [run for run in content["runs"] if (run["ground"], run["variant"]) == (ground, name)]
            if runs:
                good, count = successes(content, ground, name)
                shares = [100 * run["success"] for run in runs]
                spread = f"{min(shares):.1f} / {statistics.median(shares):.1f} / {max(shares):.1f}"
                critic = (statistics.mean(run[key] for run in runs) for key in ("explained_variance", "value_loss"))
                cells = [html.escape(ground), html.escape(words), f"{good} of {count}", spread]
                rows.append(cells + [f"{value:.3f}" for value in critic])
    columns = ["terrain", "training", "seeds that succeed", "success: least / median / most [%]"]
    return (
        head
        + note
        + statement_list(stability_statements(content))
        + chart(lambda count: stability_figure(content, count), "success and explained variance by seed", 2)
        + table([*columns, "explained variance", "value loss"], rows)
        + _made_by(content, f"seeds {', '.join(map(str, protocol['seeds']))}")
    )


def window_section(content: dict[str, Any] | None) -> str:
    """Effect of the duration T_r of the task reward, from short to the whole episode."""
    head = "<h2 id=window>The reward window T<sub>r</sub></h2>"
    if content is None:
        return head + missing("Not measured.", "python benchmarks/time_window.py gap=0.2 --samples 1e7")
    protocol = content["protocol"]
    note = (
        f"<p class=soft>Trainings on {html.escape(protocol['ground'])} that differ in T<sub>r</sub> alone, up to the "
        f"whole episode of {protocol['episode_s']:g} s, where {symbol('final')} becomes {symbol('continuous')}. "
        f"Success, path and speed by the protocol, {protocol['episodes']} episodes; costs by "
        f"<code>arrive energy</code> on flat ground. Preset {html.escape(protocol['preset'])}, "
        f"{protocol['samples'] / 1e6:g} M samples a run.</p>"
    )
    return (
        head
        + note
        + chart(lambda count: window_figure(content, count), "success, path, cost and speed by T_r", 2)
        + _made_by(content, f"seeds {', '.join(map(str, protocol['seeds']))}")
    )


def statement_list(statements: Sequence[dict[str, str]]) -> str:
    """The paper's statements with a mark each."""
    items = "".join(
        f"<li class={s['verdict']}><span class=mark>{MARKS[s['verdict']]}</span>{claim(s['claim'])} "
        f"<span class=small>({html.escape(s['why'])})</span></li>"
        for s in statements
    )
    return f"<ul class=statements>{items}</ul>"


def claim(text: str) -> str:
    """A statement with the paper's symbols set as such."""
    words = (symbol(TASKS[word]) if word in TASKS else html.escape(word) for word in text.split(" "))
    return " ".join(words)


TASKS = {symbol_: task for task, symbol_ in SYMBOLS.items()}
"""Task by its symbol."""


def _walkers(runs: Sequence[Run]) -> list[str]:
    return [run.name for run in runs]


def _names(content: dict[str, Any]) -> list[str]:
    return [policy["name"] for policy in content["policies"]]


def _told(content: dict[str, Any], rows: str, name: str) -> list[str]:
    """All values of a command that any policy got: the slowest speeds differ between policies."""
    return [f"{value:g}" for value in sorted({row[name] for policy in content["policies"] for row in policy[rows]})]


def _interval(figure: list[float] | None, digits: int) -> str:
    if figure is None:
        return "-"
    value, low, high = figure
    return f"{value:.{digits}f} <span class=small>({low:.{digits}f} to {high:.{digits}f})</span>"


def _origin(command: str, content: dict[str, Any]) -> str:
    """Command, seeds, commits and budgets of a measurement of policies."""
    policies = "; ".join(
        f"{label(policy.task, policy.name)} seed {policy.content.get('seed', '?')}, "
        f"{policy.content['samples'] / 1e6:.2f} M samples, commit {html.escape(short(policy.content['commit']))}"
        for policy in Measured.of(content)
    )
    return f"<p class=made>{code(command)}<br>Measured by {html.escape(content['commit'])}. Policies: {policies}.</p>"


def short(commit: str) -> str:
    """The first 12 digits of a commit; other words as they are."""
    return commit[:12] if re.fullmatch(r"[0-9a-f]+", commit) else commit


def _made_by(content: dict[str, Any], seeds: str) -> str:
    return f"<p class=made>{code(content['command'])}<br>{seeds}, commit {html.escape(content['commit'])}.</p>"
