"""Figure 5 of the paper: when each foot stands, and where the gait lies between Hildebrand's axes."""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from arrive.report.figure import COLUMNS, colors_of, finish, legend, panels
from arrive.report.records import Measured
from arrive.report.text import plain

HILDEBRAND = {"pace": 0.0, "lateral walk": 0.25, "trot": 0.5, "diagonal walk": 0.75}
"""Where these gaits lie on the second axis [strides]."""


def gait_figure(content: dict[str, Any], columns: int = COLUMNS) -> Figure:
    """A footfall diagram per policy, speed and direction, and Hildebrand's plot of all.

    Args:
        content: of `gait_content`.
    """
    policies = Measured.of(content)
    colors = colors_of(policies)
    walked = [(policy, row) for policy in policies for row in policy.content["gaits"] if row["gait"]]
    figure, drawn = panels(len(walked) + 1, columns)
    for (policy, row), axes in zip(walked, drawn, strict=False):
        _draw_footfalls(axes, policy, row, colors[policy.name])
    _draw_hildebrand(drawn[-1], walked, colors)
    legend(figure, drawn)
    return figure


def _draw_footfalls(axes: Axes, policy: Measured, row: dict[str, Any], color: str) -> None:
    """Bars while a foot stands, the first foot at the top."""
    feet, diagram = policy.content["feet"], row["diagram"]
    for place, stands in enumerate(diagram["stands"]):
        bars = [(start * diagram["dt_s"], length * diagram["dt_s"]) for start, length in stretches(stands)]
        axes.broken_barh(bars, (len(feet) - 1 - place - 0.36, 0.72), facecolors=color)
    axes.set_yticks(range(len(feet)), [plain(foot) for foot in reversed(feet)])
    direction = f" at {row['direction_deg']:g}°" if row["direction_deg"] else ""
    title = f"{policy.label}: {plain(row['gait'])}, commanded {row['told_m_s']:.3g} m/s{direction}"
    finish(axes, title, f"time [s]; {row['speed_m_s'][0]:.2f} m/s towards {row['travel_deg']:+.0f}° of the heading", "")
    axes.grid(False, axis="y")


def stretches(stands: Sequence[int]) -> list[tuple[int, int]]:
    """First step and length of each stretch of ones."""
    found, start = [], None
    for step, value in enumerate([*stands, 0]):
        if value and start is None:
            start = step
        elif not value and start is not None:
            found.append((start, step - start))
            start = None
    return found


def _draw_hildebrand(axes: Axes, walked: Sequence[tuple[Measured, dict[str, Any]]], colors: dict[str, str]) -> None:
    for policy, row in walked:
        place = row["hildebrand"]
        if place:
            x, y = 100 * place["hind_duty"], 100 * place["fore_after_hind"]
            axes.plot([x], [y], "o", color=colors[policy.name], markersize=7, label=policy.label)
    for name, share in HILDEBRAND.items():
        axes.axhline(100 * share, color="0.8", linewidth=0.8, zorder=0)
        axes.text(1, 100 * share + 1, name, fontsize=8, color="0.45", ha="right")
    axes.set_xlim(100, 0)
    axes.set_ylim(-2, 102)
    finish(axes, "Hildebrand", "hind foot stands [% of the stride]", "fore after hind foot [%]")
