"""Figure 4 of the paper: what walking costs at the speed that was really reached."""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from arrive.report.figure import COLUMNS, colors_of, finish, legend, panels
from arrive.report.records import Measured

PANELS = {
    "torque_sq": ("sum of squared torques", "[N² m² s / m]"),
    "cost_of_transport": ("cost of transport (positive work)", "work / (m g way)"),
}


def energy_figure(content: dict[str, Any], columns: int = COLUMNS) -> Figure:
    """Squared torques and cost of transport over the speed reached, and how many robots did not get to the end.

    Args:
        content: of `energy_content`. Points of one policy are joined in the order of commanded speeds; bars are 95 %
            intervals.
    """
    figure, drawn = panels(3, columns)
    colors = colors_of(Measured.of(content))
    for policy in Measured.of(content):
        color, rows = colors[policy.name], policy.content["speeds"]
        for axes, name in zip(drawn, PANELS, strict=False):
            _draw_cost(axes, [row for row in rows if row[name]], name, color, policy.label)
        lost = [100 * (row["fell"] + row["stood"]) / row["robots"] for row in rows]
        drawn[2].plot([row["told_m_s"] for row in rows], lost, color=color, marker="o", markersize=3.5)
    for axes, (title, unit) in zip(drawn, PANELS.values(), strict=False):
        finish(axes, title, "speed reached [m/s]", unit)
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
    finish(drawn[2], "fell or stood still", "commanded speed [m/s]", "robots [%]")
    drawn[2].set_ylim(-3, 103)
    legend(figure, drawn)
    return figure


def _draw_cost(axes: Axes, rows: Sequence[dict[str, Any]], name: str, color: str, label: str) -> None:
    if not rows:
        axes.plot([], [], color=color, marker="o", label=f"{label}: nobody walked")
        return
    (speed, *speed_ends), (cost, *cost_ends) = ([list(column) for column in zip(*values, strict=True)] for values in (
        [row["speed"] for row in rows], [row[name] for row in rows]))  # fmt: skip
    errors = [
        [[abs(end - value) for end, value in zip(ends[side], values, strict=True)] for side in (0, 1)]
        for values, ends in ((speed, speed_ends), (cost, cost_ends))
    ]
    axes.errorbar(
        speed, cost, xerr=errors[0], yerr=errors[1], color=color, marker="o", markersize=4, linewidth=1.2, label=label
    )
