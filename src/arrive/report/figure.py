"""What all charts of a report share: colours, panels, axes and the way to SVG."""

import io
import math
from collections.abc import Iterable, Sequence
from typing import Protocol

import matplotlib
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

COLORS = {"velocity": "#d55e00", "continuous": "#009e73", "final": "#0072b2"}
"""Of the first policy of a task."""
OTHER_COLORS = ("#cc79a7", "#e69f00", "#56b4e9", "#7a4fa3", "#8c564b", "#6b8e23", "#b3261e", "#444a52")
"""Of all others, in turn."""
COLUMNS = 3
PANEL_IN = (4.3, 2.9)


class Named(Protocol):
    """A policy in a chart: a name and the task that it was trained on."""

    @property
    def name(self) -> str: ...

    @property
    def task(self) -> str: ...


def color_of(task: str) -> str:
    """The colour that stands for a task where no policy is meant."""
    return COLORS.get(task, OTHER_COLORS[-1])


def colors_of(policies: Iterable[Named]) -> dict[str, str]:
    """A colour per policy, by name: the task's own for its first one, and others for those that follow."""
    colors: dict[str, str] = {}
    for policy in policies:
        own = COLORS.get(policy.task)
        if own is None or own in colors.values():
            taken = len([color for color in colors.values() if color in OTHER_COLORS])
            own = OTHER_COLORS[taken % len(OTHER_COLORS)]
        colors.setdefault(policy.name, own)
    return colors


def panels(count: int, columns: int = COLUMNS, size: tuple[float, float] = PANEL_IN) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels in rows.

    Args:
        size: width and height of a panel [inch].
    """
    columns = min(columns, max(count, 1))
    rows = max(math.ceil(count / columns), 1)
    figure = Figure(figsize=(size[0] * columns, size[1] * rows + 0.4), layout="constrained")
    return figure, [figure.add_subplot(rows, columns, i + 1) for i in range(count)]


def finish(axes: Axes, title: str, x: str, y: str) -> None:
    """Title, labels and grid of a panel."""
    axes.set_title(title, fontsize=10, fontweight="bold", loc="left")
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(True, color="0.92", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def legend(figure: Figure, drawn: Sequence[Axes]) -> None:
    """One legend above all panels, with every label once."""
    lines: dict[str, Artist] = {}
    for axes in drawn:
        lines |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    if lines:
        ncols = max(int(figure.get_figwidth() / PANEL_IN[0] * 4 / COLUMNS), 1)
        figure.legend(
            list(lines.values()),
            list(lines),
            loc="outside upper left",
            ncols=ncols,
            fontsize=9,
            frameon=False,
            handlelength=4,
        )


def svg_text(figure: Figure) -> str:
    """The figure as SVG; the same text whenever the same is drawn."""
    FigureCanvasSVG(figure)
    text = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "arrive"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()
