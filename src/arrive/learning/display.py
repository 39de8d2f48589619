"""Shows the progress of training: a live panel in a terminal, otherwise a line from time to time."""

import math
import time
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

from rich.columns import Columns
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from arrive.learning.report import FamilyReport, IterationReport
from arrive.task.curriculum import FOUND

BARS = "▁▂▃▄▅▆▇█"
ASCII_BARS = "_.:-=+*#"
MAX_BARS = 24
"""A histogram with more levels than this merges neighbouring levels."""
TOP_FAILURES = 4


class TrainingDisplay:
    """Context manager that shows each report."""

    def __init__(self, title: str, folder: Path | str, console: Console | None = None, line_every_s: float = 10.0):
        """
        Args:
            title: robot, terrain and preset.
            folder: the run's folder.
            console: where to write; standard output by default.
            line_every_s: shortest time between two lines if the output is not a terminal [s].
        """
        self._title, self._folder = title, str(folder)
        self._console = console or Console()
        self._line_every_s = line_every_s
        self._live: Live | None = None
        self._last_line_s = -math.inf
        self._unprinted: IterationReport | None = None
        self._warned: set[str] = set()

    def __enter__(self) -> "TrainingDisplay":
        if self._console.is_terminal:
            # Only `update` refreshes it: a refresh thread would take time from the physics.
            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        else:
            self.say(f"{self._title}: {self._folder}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
        elif self._unprinted is not None:
            self.say(plain_line(self._unprinted))

    def update(self, report: IterationReport) -> None:
        """Show one iteration."""
        if self._live is not None:
            unicode = self._console.encoding.lower().startswith("utf")
            self._live.update(panel(report, self._title, self._folder, BARS if unicode else ASCII_BARS), refresh=True)
            return
        self._unprinted = report
        for name in report.warnings.keys() - self._warned:
            self.say(f"warning: {report.warnings[name]}")
        self._warned = set(report.warnings)
        if time.monotonic() - self._last_line_s >= self._line_every_s:
            self.say(plain_line(report))
            self._last_line_s, self._unprinted = time.monotonic(), None

    def say(self, line: str) -> None:
        """Show one line of text, in a terminal above the panel."""
        self._console.print(line, soft_wrap=True, highlight=False, markup=False)


def plain_line(report: IterationReport) -> str:
    """One iteration in one line of plain ASCII text, for log files and pipes."""
    families = ", ".join(
        f"{name} {_percent(family.arrival)}" + (f" level {family.mean_level:.1f}" if len(family.levels) > 1 else "")
        for name, family in report.families.items()
    )
    parts = [
        f"iteration {report.iteration}",
        f"{_percent(report.budget)} of budget, {_clock(report.elapsed_s)} elapsed, {_clock(report.time_left_s)} left",
        f"{count(report.samples)} samples, {report.samples_per_s:,.0f}/s",
        f"arrival {_percent(report.arrival)}" + (f" ({families})" if families else ""),
        f"exploration reward {exploration_state(report)}",
    ]
    if report.failures:
        parts.append(", ".join(f"{name} {_percent(share)}" for name, share in _top(report.failures)))
    return " | ".join(parts)


def panel(report: IterationReport, title: str, folder: str, bars: str = BARS) -> Panel:
    """One iteration as a panel for terminals of at least 80 columns."""
    parts: list[RenderableType] = [_progress(report), _summary(report)]
    parts += [Text(f"warning: {text}", "bold red") for text in report.warnings.values()]
    if report.families:
        parts.append(_families(report.families, bars))
    if report.failures:
        shares = {name: _percent(share) for name, share in _top(report.failures)}
        parts += [_heading("failures, share of episodes"), _figures(shares.items())]
    if report.rewards:
        values = {name: f"{value:+.3g}" for name, value in report.rewards.items()}
        parts += [_heading("rewards per step"), _figures(values.items(), signed=True)]
    if report.learning:
        values = {name: f"{value:.3g}" for name, value in report.learning.items()}
        parts += [_heading("learning"), _figures(values.items())]
    return Panel(Group(*parts), title=Text(title, "bold"), subtitle=Text(folder, "dim"), border_style="cyan")


def exploration_state(report: IterationReport) -> str:
    """Whether the exploration reward (paper, eq. 3) is still paid, and until when."""
    if not report.exploration_paid:
        return "removed"
    where = "paid" if report.exploration_paid == 1.0 else f"paid to {_percent(report.exploration_paid)} of the robots"
    present, until = _percent(report.task_fraction), _percent(FOUND)
    return f"{where}, task reward at {present} of its maximum; until {until}"


def level_bars(levels: tuple[int, ...], bars: str = BARS) -> Text:
    """Histogram of robots per level, lowest level first. A dimmed bar of the lowest height means no robots."""
    pool = math.ceil(len(levels) / MAX_BARS)
    counts = [sum(levels[start : start + pool]) for start in range(0, len(levels), pool)]
    top, steps = max(counts, default=0), len(bars) - 1
    text = Text(no_wrap=True)
    for robots in counts:
        text.append(bars[math.ceil(robots / top * steps)] if robots else bars[0], "green" if robots else "dim")
    return text


def _progress(report: IterationReport) -> Table:
    row = Table.grid(padding=(0, 1), expand=True)
    row.add_column(ratio=1)
    row.add_column(no_wrap=True, justify="right")
    share = min(max(report.budget, 0.0), 1.0)
    clock = f"{_percent(share)}   {_clock(report.elapsed_s)} elapsed   {_clock(report.time_left_s)} left"
    row.add_row(ProgressBar(total=1.0, completed=share), clock)
    return row


def _summary(report: IterationReport) -> Table:
    table = Table.grid(padding=(0, 2))
    progress = f"{count(report.samples)} samples   {report.samples_per_s:,.0f}/s   iteration {report.iteration:,}"
    table.add_row("progress", progress)
    table.add_row("arrival", Text(_percent(report.arrival), "bold green"))
    table.add_row("exploration reward", exploration_state(report))
    return table


def _families(families: dict[str, FamilyReport], bars: str) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("terrain", no_wrap=True)
    table.add_column("arrival", justify="right", no_wrap=True)
    table.add_column("mean level", justify="right", no_wrap=True)
    table.add_column("robots by level", no_wrap=True)
    table.add_column("main failures", no_wrap=True)
    for name, family in families.items():
        mean, histogram = "", Text()
        if len(family.levels) > 1:
            mean, histogram = f"{family.mean_level:.1f} of {len(family.levels) - 1}", level_bars(family.levels, bars)
        worst = _top(family.failures)[:1] if any(family.failures.values()) else []
        failures = [f"{cause} {_percent(share)}" for cause, share in worst]
        table.add_row(name, _percent(family.arrival), mean, histogram, *failures)
    return table


def _figures(figures: Iterable[tuple[str, str]], signed: bool = False) -> Columns:
    figures = list(figures)
    name_width = max(len(name) for name, _ in figures)
    value_width = max(len(value) for _, value in figures)
    cells = []
    for name, value in figures:
        style = ("red" if value.startswith("-") else "green") if signed else "bold"
        cells.append(Text(f"{name:<{name_width}} ") + Text(f"{value:>{value_width}}", style))
    return Columns(cells, padding=(0, 3, 0, 0), equal=True)


def _heading(text: str) -> Text:
    return Text(text, "dim")


def _top(failures: dict[str, float]) -> list[tuple[str, float]]:
    return sorted(failures.items(), key=lambda item: -item[1])[:TOP_FAILURES]


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if math.isfinite(share) else "-"


def _clock(seconds: float) -> str:
    if not math.isfinite(seconds):
        return "-"
    minutes, second = divmod(round(max(seconds, 0.0)), 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour}:{minute:02d}:{second:02d}" if hour else f"{minute}:{second:02d}"


def count(number: int) -> str:
    """A number with its prefix, such as 983.04 k."""
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= size:
            return f"{number / size:.2f} {unit}"
    return str(number)
