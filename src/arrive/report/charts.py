"""The report's charts of runs: success, use of time, training."""

import math
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from arrive.report.figure import COLUMNS, color_of, colors_of, finish, legend, panels
from arrive.report.reach import ground_words
from arrive.report.records import Run
from arrive.report.table import PAPER
from arrive.terrain import get_family

LineStyle = tuple[int, tuple[float, ...]]
DASHES: tuple[tuple[float, ...], ...] = (
    (),
    (4, 2),
    (1, 1.5),
    (6, 2, 1, 2),
    (9, 2),
    (3, 2, 1, 2, 1, 2),
    (2, 2),
    (9, 2, 2, 2),
)
"""Of the lines of one task's runs: the lengths of dash and space in turn [line widths]; none for a solid line."""
RUNNING_MEAN = 40
"""Strong training curves are means over this share of the run, one part in so many."""


def difficulty_chart(runs: Sequence[Run], columns: int = COLUMNS) -> Figure:
    """Success against the terrain's parameter with 95 % intervals, a panel per family that has one."""
    names = [name for name in _measured(runs) if get_family(name).unit]
    figure, drawn = panels(len(names), columns)
    for name, axes in zip(names, drawn, strict=True):
        family = get_family(name)
        for run, color, style in _styled(runs):
            results = run.results().get(name)
            if results:
                values = [result.cell.value for result in results]
                low, high = zip(*(result.interval for result in results), strict=True)
                share = [100 * result.success for result in results]
                axes.plot(values, share, color=color, ls=style, marker="o", markersize=3.5, label=run.label)
                axes.fill_between(values, *_percent(low, high), color=color, alpha=0.15, linewidth=0)
        for task, value in PAPER.get(name, {}).items():
            if value is not None:
                axes.axvline(value, color=color_of(task), linestyle=(0, (1, 2)), linewidth=1.4)
        axes.axhline(95, color="0.6", linewidth=0.8)
        axes.set_ylim(-3, 103)
        finish(axes, f"{name}: {family.description}", f"{family.parameter} [{family.unit}]", "success [%]")
    legend(figure, drawn)
    return figure


def training_chart(runs: Sequence[Run], columns: int = 2) -> Figure:
    """Arrival and mean terrain level over samples."""
    figure, drawn = panels(2, columns)
    for run, color, style in _styled(runs):
        samples = [count / 1e6 for count in run.log.get("progress/samples", [])]
        levels = [
            values for name, values in run.log.items() if name.startswith("level/") and any(v > 0 for v in values)
        ]
        mean_level = [sum(row) / len(row) for row in zip(*levels, strict=True)]
        for axes, values in ((drawn[0], [100 * v for v in run.log.get("arrival/all", [])]), (drawn[1], mean_level)):
            if values:
                axes.plot(samples, _smooth(values), color=color, ls=style, label=run.label)
    finish(drawn[0], "success of recent episodes while learning", "samples [million]", "[%]")
    finish(drawn[1], "mean terrain level", "samples [million]", "level")
    drawn[0].set_ylim(0, 103)
    drawn[1].set_ylim(bottom=0)
    legend(figure, drawn)
    return figure


def speed_chart(runs: Sequence[Run], columns: int = COLUMNS, level: int = 0) -> Figure:
    """Mean horizontal speed over time of the successful episodes at each family's easiest level."""
    names = _measured(runs)
    figure, drawn = panels(len(names), columns)
    for name, axes in zip(names, drawn, strict=True):
        family = get_family(name)
        title = name
        for run, color, style in _styled(runs):
            rows = run.difficulty["policy"]["usage"].get(name) if run.difficulty else None
            if rows and {"speed_profile", "arrival_time_s"} <= rows[level].keys():
                profile, median = rows[level]["speed_profile"], rows[level]["arrival_time_s"][1]
                axes.plot(profile["time_s"], profile["mean_m_s"], color=color, ls=style, label=run.label)
                axes.axvline(median, color=color, linestyle=(0, (1, 2)), linewidth=1.4)
                title = f"{name} {rows[level]['value']:.3g} {family.unit}" if family.unit else name
        axes.set_ylim(bottom=0)
        axes.set_xlim(0, max(run.difficulty["protocol"]["trial"]["duration_s"] for run in runs if run.difficulty))
        finish(axes, title, "time [s]", "speed [m/s]")
    legend(figure, drawn)
    return figure


def reach_chart(runs: Sequence[Run], columns: int = COLUMNS) -> Figure:
    """Success by the target's distance and by its direction with 95 % intervals, two panels per family."""
    names = list(dict.fromkeys(name for run in runs if run.reach for name in run.reach["families"]))
    figure, drawn = panels(2 * len(names), columns)
    for name, by_distance, by_direction in zip(names, drawn[::2], drawn[1::2], strict=True):
        for run, color, style in _styled(runs):
            entry = run.reach["families"].get(name) if run.reach else None
            if entry:
                told = entry["waiting"]["time_s"]
                rows = [row for row in entry["distances"] if row["time_s"] == told]
                where = f"{run.label}, {ground_words(name, entry)}, {told:g} s"
                _draw_share(by_distance, [row["distance_m"] for row in rows], rows, color, style, where)
                around = entry["directions"]
                _draw_share(by_direction, [row["direction_deg"] for row in around], around, color, style)
        finish(by_distance, f"{name}: straight ahead", "distance of the target [m]", "success [%]")
        finish(by_direction, f"{name}: all directions", "direction of the target [deg]", "success [%]")
        by_direction.set_xticks(range(0, 361, 45))
        for axes in (by_distance, by_direction):
            axes.set_ylim(-3, 103)
    legend(figure, drawn)
    return figure


def _draw_share(
    axes: Axes,
    x: Sequence[float],
    rows: Sequence[dict[str, Any]],
    color: str,
    style: LineStyle,
    label: str | None = None,
) -> None:
    low, high = zip(*(row["interval"] for row in rows), strict=True)
    axes.plot(x, [100 * row["success"] for row in rows], color=color, ls=style, marker="o", markersize=3.5, label=label)
    axes.fill_between(x, *_percent(low, high), color=color, alpha=0.15, linewidth=0)


def _measured(runs: Sequence[Run]) -> list[str]:
    return list(dict.fromkeys(name for run in runs for name in run.results()))


def _styled(runs: Sequence[Run]) -> list[tuple[Run, str, LineStyle]]:
    """Runs with the colour and the line style that tell them apart."""
    colors = colors_of(runs)
    seen: dict[str, int] = {}
    styled: list[tuple[Run, str, LineStyle]] = []
    for run in runs:
        count = seen[run.task] = seen.get(run.task, -1) + 1
        styled.append((run, colors[run.name], (0, DASHES[count % len(DASHES)])))
    return styled


def _percent(low: Sequence[float], high: Sequence[float]) -> tuple[list[float], list[float]]:
    return [100 * value for value in low], [100 * value for value in high]


def _smooth(values: Sequence[float]) -> list[float]:
    """Trailing mean of the numbers among the last values; NaN where there is none."""
    window = max(len(values) // RUNNING_MEAN, 1)
    smooth = []
    for end in range(1, len(values) + 1):
        known = [value for value in values[max(end - window, 0) : end] if math.isfinite(value)]
        smooth.append(sum(known) / len(known) if known else math.nan)
    return smooth
