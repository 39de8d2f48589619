"""Charts of trainings that differ in one thing: the paper's changes for stability, and the reward window T_r."""

from typing import Any

from matplotlib.figure import Figure

from arrive.report.figure import COLUMNS, OTHER_COLORS, finish, legend, panels
from arrive.report.text import plain


def stability_figure(content: dict[str, Any], columns: int = COLUMNS) -> Figure:
    """Every seed's success by what was undone, and the value function's explained variance over the samples.

    Args:
        content: written by benchmarks/stability.py.
    """
    grounds, variants = content["protocol"]["grounds"], content["variants"]
    figure, drawn = panels(2 * len(grounds), min(columns, 2))
    for ground, success, variance in zip(grounds, drawn[::2], drawn[1::2], strict=True):
        for place, (name, words) in enumerate(variants.items()):
            color = OTHER_COLORS[place % len(OTHER_COLORS)]
            runs = [run for run in content["runs"] if (run["ground"], run["variant"]) == (ground, name)]
            success.plot([place] * len(runs), [100 * run["success"] for run in runs], "o", color=color, alpha=0.7)
            for number, run in enumerate(runs):
                samples = [count / 1e6 for count in run["curve"]["samples"]]
                own = plain(words) if number == 0 else None
                variance.plot(samples, run["curve"]["explained_variance"], color=color, linewidth=1, label=own)
        success.axhline(100 * content["protocol"]["goal"], color="0.6", linewidth=0.8)
        success.set_xticks(range(len(variants)), [plain(name) for name in variants], rotation=20, ha="right")
        success.set_ylim(-3, 103)
        success.set_xlim(-0.5, len(variants) - 0.5)
        finish(success, f"{plain(ground)}: every seed", "", "success [%]")
        success.tick_params(axis="x", labelsize=8)
        variance.set_ylim(-0.2, 1.03)
        finish(variance, f"{plain(ground)}: the critic", "samples [million]", "explained variance")
    legend(figure, drawn)
    return figure


def window_figure(content: dict[str, Any], columns: int = COLUMNS) -> Figure:
    """Success, time and path to the target, cost of walking and speed profile against T_r.

    Args:
        content: written by benchmarks/time_window.py.
    """
    figure, drawn = panels(4, min(columns, 2))
    runs = sorted(content["runs"], key=lambda run: (run["window_s"], run["seed"]))
    windows = sorted({run["window_s"] for run in runs})
    success, way, cost, profile = drawn
    for run in runs:
        low, high = run["interval"]
        share = run["success"]
        error = [[100 * max(share - low, 0.0)], [100 * max(high - share, 0.0)]]
        success.errorbar([run["window_s"]], [100 * share], yerr=error, color=OTHER_COLORS[0], marker="o", markersize=4)
        color = OTHER_COLORS[windows.index(run["window_s"]) % len(OTHER_COLORS)]
        if run["path_length_m"]:
            way.plot(run["window_s"], run["path_length_m"][1], "o", color="#0072b2", label="path [m]")
            way.plot(run["window_s"], run["arrival_time_s"][1], "s", color="#d55e00", label="time [s]")
            curve = run["speed_profile"]
            profile.plot(curve["time_s"], curve["mean_m_s"], color=color, label=f"$T_r$ = {run['window_s']:g} s")
        for row in run["energy"]:
            if row["torque_sq"]:
                value, *ends = row["torque_sq"]
                cost.errorbar(
                    [row["speed"][0]], [value], yerr=[[abs(end - value)] for end in ends], color=color, marker="o"
                )
    success.set_ylim(-3, 103)
    finish(success, "success", "$T_r$ [s]", "[%]")
    finish(way, "path and time to the target, medians", "$T_r$ [s]", "[m], [s]")
    finish(cost, "sum of squared torques", "speed reached [m/s]", "[N² m² s / m]")
    finish(profile, "speed on the way", "time [s]", "[m/s]")
    for axes in (way, cost, profile):
        axes.set_ylim(bottom=0)
    legend(figure, drawn)
    return figure
