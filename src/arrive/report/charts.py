"""The report's charts, as SVG text."""

import io
import math
from collections.abc import Sequence

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from arrive.report.records import Run
from arrive.report.table import PAPER
from arrive.terrain import get_family

COLORS = {"velocity": "#d55e00", "continuous": "#009e73", "final": "#0072b2"}
OTHER_COLOR = "#7a4fa3"
DASHES = ((), (4, 2), (1, 1.5), (6, 2, 1, 2), (9, 2), (3, 2, 1, 2, 1, 2), (2, 2), (9, 2, 2, 2))
"""Of the lines of one task's runs: the lengths of dash and space in turn [line widths]; none for a solid line."""
COLUMNS = 3
PANEL_IN = (4.3, 2.9)
RUNNING_MEAN = 40
"""Strong training curves are means over this share of the run, one part in so many."""


def color_of(task: str) -> str:
    """The colour that stands for a task everywhere in a report."""
    return COLORS.get(task, OTHER_COLOR)


def difficulty_chart(runs: Sequence[Run]) -> str:
    """Success against the terrain's parameter with 95 % intervals, a panel per family that has one."""
    names = [name for name in _measured(runs) if get_family(name).unit]
    figure, panels = _panels(len(names))
    for name, axes in zip(names, panels, strict=True):
        family = get_family(name)
        for run, style in _styled(runs):
            results = run.results().get(name)
            if results:
                values = [result.cell.value for result in results]
                low, high = zip(*(result.interval for result in results), strict=True)
                share = [100 * result.success for result in results]
                axes.plot(
                    values, share, color=color_of(run.task), ls=style, marker="o", markersize=3.5, label=run.label
                )
                axes.fill_between(values, *_percent(low, high), color=color_of(run.task), alpha=0.15, linewidth=0)
        for task, value in PAPER.get(name, {}).items():
            if value is not None:
                axes.axvline(value, color=color_of(task), linestyle=(0, (1, 2)), linewidth=1.4)
        axes.axhline(95, color="0.6", linewidth=0.8)
        axes.set_ylim(-3, 103)
        _finish(axes, f"{name}: {family.description}", f"{family.parameter} [{family.unit}]", "success [%]")
    return _svg(figure, panels)


def training_chart(runs: Sequence[Run]) -> str:
    """Arrival and mean terrain level over samples."""
    figure, panels = _panels(2, columns=2)
    for run, style in _styled(runs):
        samples = [count / 1e6 for count in run.log.get("progress/samples", [])]
        levels = [
            values for name, values in run.log.items() if name.startswith("level/") and any(v > 0 for v in values)
        ]
        mean_level = [sum(row) / len(row) for row in zip(*levels, strict=True)]
        for axes, values in ((panels[0], [100 * v for v in run.log.get("arrival/all", [])]), (panels[1], mean_level)):
            if values:
                axes.plot(samples, _smooth(values), color=color_of(run.task), ls=style, label=run.label)
    _finish(panels[0], "success of recent episodes while learning", "samples [million]", "[%]")
    _finish(panels[1], "mean terrain level", "samples [million]", "level")
    panels[0].set_ylim(0, 103)
    panels[1].set_ylim(bottom=0)
    return _svg(figure, panels)


def speed_chart(runs: Sequence[Run], level: int = 0) -> str:
    """Mean horizontal speed over time of the successful episodes at each family's easiest level."""
    names = _measured(runs)
    figure, panels = _panels(len(names))
    for name, axes in zip(names, panels, strict=True):
        family = get_family(name)
        title = name
        for run, style in _styled(runs):
            rows = run.difficulty["policy"]["usage"].get(name) if run.difficulty else None
            if rows and "speed_profile" in rows[level]:
                profile, median = rows[level]["speed_profile"], rows[level]["arrival_time_s"][1]
                axes.plot(profile["time_s"], profile["mean_m_s"], color=color_of(run.task), ls=style, label=run.label)
                axes.axvline(median, color=color_of(run.task), linestyle=(0, (1, 2)), linewidth=1.4)
                title = f"{name} {rows[level]['value']:.3g} {family.unit}" if family.unit else name
        axes.set_ylim(bottom=0)
        axes.set_xlim(0, 8)
        _finish(axes, title, "time [s]", "speed [m/s]")
    return _svg(figure, panels)


def _measured(runs: Sequence[Run]) -> list[str]:
    return list(dict.fromkeys(name for run in runs for name in run.results()))


def _styled(runs: Sequence[Run]) -> list[tuple[Run, tuple[int, tuple[float, ...]]]]:
    """Runs with the line style that tells those of one task apart."""
    seen: dict[str, int] = {}
    styled = []
    for run in runs:
        count = seen[run.task] = seen.get(run.task, -1) + 1
        styled.append((run, (0, DASHES[count % len(DASHES)])))
    return styled


def _percent(low: Sequence[float], high: Sequence[float]) -> tuple[list[float], list[float]]:
    return [100 * value for value in low], [100 * value for value in high]


def _panels(count: int, columns: int = COLUMNS) -> tuple[Figure, list[Axes]]:
    columns = min(columns, max(count, 1))
    rows = max(math.ceil(count / columns), 1)
    figure = Figure(figsize=(PANEL_IN[0] * columns, PANEL_IN[1] * rows + 0.4), layout="constrained")
    FigureCanvasSVG(figure)
    return figure, [figure.add_subplot(rows, columns, i + 1) for i in range(count)]


def _finish(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10, fontweight="bold", loc="left")
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(True, color="0.92", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _smooth(values: Sequence[float]) -> list[float]:
    """Trailing mean of the numbers among the last values; NaN where there is none."""
    window = max(len(values) // RUNNING_MEAN, 1)
    smooth = []
    for end in range(1, len(values) + 1):
        known = [value for value in values[max(end - window, 0) : end] if math.isfinite(value)]
        smooth.append(sum(known) / len(known) if known else math.nan)
    return smooth


def _svg(figure: Figure, panels: Sequence[Axes]) -> str:
    """One legend above all panels, and the same text whenever the same is drawn."""
    lines = {}
    for axes in panels:
        lines |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    if lines:
        figure.legend(
            lines.values(), lines.keys(), loc="outside upper left", ncols=4, fontsize=9, frameon=False, handlelength=4
        )
    text = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "arrive"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()
