"""Draws the curves of a run from its log as one picture."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from arrive.colors import COLORS
from arrive.files import whole
from arrive.learning.logs import read_log
from arrive.policies import CURVES_NAME

STYLES = ("-", "--", ":")
SMALL_COLUMNS = 3
WIDTH_IN, WIDE_HEIGHT_IN, SMALL_HEIGHT_IN = 12.0, 3.1, 2.2

Log = dict[str, np.ndarray]


def plot_curves(folder: Path) -> Path:
    """Draw `curves.png` into a run's folder from its `log.csv` and return its path.

    The picture shows success rate, terrain levels, rewards and all learning metrics over samples. The background is
    shaded while the exploration reward was paid. Strong lines are moving averages, faint ones single iterations.

    Raises:
        ArriveError: the folder has no log, or the picture cannot be written.
    """
    log = {name: _finite(values) for name, values in read_log(folder).items()}
    path = Path(folder) / CURVES_NAME
    figure = _draw(log)
    with whole(path) as file:
        figure.savefig(file, format="png", dpi=110)
    return path


def _draw(log: Log) -> Figure:
    """Wide panels above each other with legends on the right, and the learning metrics below."""
    small = _group(log, "learning/")
    rows = -(-len(small) // SMALL_COLUMNS)
    colors = {name: COLORS[i % len(COLORS)] for i, name in enumerate(_group(log, "arrival/"))}
    panels = [lambda axes: _arrival(axes, log, colors), lambda axes: _rewards(axes, log)]
    if _climbing(log):
        panels.insert(1, lambda axes: _levels(axes, log, colors))
    wide_in, small_in = len(panels) * WIDE_HEIGHT_IN, rows * SMALL_HEIGHT_IN
    figure = Figure(figsize=(WIDTH_IN, wide_in + small_in))
    FigureCanvasAgg(figure)
    split, edge = small_in / (wide_in + small_in), 0.4 / (wide_in + small_in)
    wide = figure.add_gridspec(
        len(panels), 1, left=0.06, right=0.79, top=1 - edge, bottom=split + 1.6 * edge, hspace=0.35
    )
    for place, draw in enumerate(panels):
        _panel(figure, wide[place], log, draw)
    if small:
        below = {"top": split - edge, "bottom": 1.4 * edge, "hspace": 0.6, "wspace": 0.22}
        grid = figure.add_gridspec(rows, SMALL_COLUMNS, left=0.06, right=0.98, **below)
        for place, name in enumerate(small):
            _panel(figure, grid[divmod(place, SMALL_COLUMNS)], log, partial(_learning, log=log, name=name))
    return figure


def _panel(figure: Figure, place: SubplotSpec, log: Log, draw: Callable[[Axes], None]) -> None:
    axes = figure.add_subplot(place)
    _shade_exploration(axes, log)
    draw(axes)
    _finish(axes, log)


def _arrival(axes: Axes, log: Log, colors: dict[str, str]) -> None:
    axes.set_title("success rate, share of finished episodes [%]")
    for name, values in _group(log, "arrival/").items():
        color, width = ("black", 2.4) if name == "all" else (colors[name], 1.5)
        _curve(axes, log, 100 * values, name, color, width=width)
    fraction = log.get("exploration/task_fraction")
    if fraction is not None:
        axes.plot(_samples(log), 100 * fraction, ":", color="0.45", label="task reward (% of maximum)")
    axes.set_ylim(0, 100)
    _legend(axes)


def _climbing(log: Log) -> Log:
    """Levels of the families that have left their first level. A family with a single level never does."""
    return {name: values for name, values in _group(log, "level/").items() if np.nanmax(values, initial=0.0) > 0}


def _levels(axes: Axes, log: Log, colors: dict[str, str]) -> None:
    axes.set_title("mean terrain level")
    for name, values in _climbing(log).items():
        _curve(axes, log, values, name, colors.get(name, "black"))
    axes.set_ylim(bottom=0)
    _legend(axes)


def _rewards(axes: Axes, log: Log) -> None:
    axes.set_title("mean reward per step and term, symmetric logarithmic scale")
    terms = _group(log, "rewards/")
    largest = max((np.nanmax(np.abs(values)) for values in terms.values() if np.isfinite(values).any()), default=0.0)
    if largest > 0:
        axes.set_yscale("symlog", linthresh=largest / 100)
    axes.axhline(0, color="0.5", linewidth=0.8)
    for i, (name, values) in enumerate(terms.items()):
        _curve(axes, log, values, name, COLORS[i % len(COLORS)], STYLES[i // len(COLORS) % len(STYLES)])
    _legend(axes)


def _learning(axes: Axes, log: Log, name: str) -> None:
    values = log[f"learning/{name}"]
    axes.set_title(name.replace("_", " "))
    if "rate" in name and np.nanmin(values, initial=np.inf) > 0:
        axes.set_yscale("log")
    _curve(axes, log, values, name, COLORS[0])


def _curve(
    axes: Axes, log: Log, values: np.ndarray, label: str, color: str, style: str = "-", width: float = 1.5
) -> None:
    axes.plot(_samples(log), values, color=color, linewidth=0.8, alpha=0.2)
    axes.plot(_samples(log), _running_mean(values), style, color=color, linewidth=width, label=label)


def _shade_exploration(axes: Axes, log: Log) -> None:
    """Shade the samples during which the exploration reward was paid to some robots."""
    active = log.get("exploration/paid", np.zeros(0)) > 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]]).astype(int)))
    samples = _samples(log)
    for number, (start, stop) in enumerate(edges.reshape(-1, 2)):
        label = "exploration reward paid" if number == 0 else None
        axes.axvspan(samples[start], samples[stop - 1], color="#f2e6b8", alpha=0.5, linewidth=0, label=label)


def _finish(axes: Axes, log: Log) -> None:
    samples = _samples(log)
    if len(samples) > 1 and np.nanmax(samples, initial=-np.inf) > np.nanmin(samples, initial=np.inf):
        axes.set_xlim(np.nanmin(samples), np.nanmax(samples))
    axes.set_xlabel("samples [million]", fontsize=8)
    axes.title.set(fontsize=10, fontweight="bold")
    axes.tick_params(which="both", labelsize=8)
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _legend(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)


def _finite(values: list[float]) -> np.ndarray:
    """The values with infinities replaced by NaN, which matplotlib leaves out."""
    array = np.asarray(values, dtype=float)
    return np.where(np.isfinite(array), array, np.nan)


def _samples(log: Log) -> np.ndarray:
    return log.get("progress/samples", np.zeros(0)) / 1e6


def _group(log: Log, prefix: str) -> Log:
    """The columns of one group, without the prefix."""
    return {name.removeprefix(prefix): values for name, values in log.items() if name.startswith(prefix)}


def _running_mean(values: np.ndarray) -> np.ndarray:
    """Centred moving average of the finite values over a fiftieth of the run; NaN where the value itself is NaN."""
    window = max(1, len(values) // 50)
    finite = np.isfinite(values)
    kernel = np.ones(window)
    if not len(values):
        return values
    total = np.convolve(np.where(finite, values, 0.0), kernel, mode="same")
    count = np.convolve(finite.astype(float), kernel, mode="same")
    return np.where(finite, total / np.maximum(count, 1.0), np.nan)
