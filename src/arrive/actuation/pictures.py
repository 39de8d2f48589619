"""Pictures of motors: predicted against measured torque, and their responses side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from arrive.actuation.clip import TorqueClip
from arrive.actuation.fit import FitResult
from arrive.actuation.motor import Motor
from arrive.actuation.responses import DriveModel, frequency_response, loaded_step, locked_step, torque_at_speed
from arrive.colors import COLORS
from arrive.files import whole

LOCKED_STEP_RAD, LOADED_STEP_RAD, SINE_RAD = 0.3, 0.5, 0.1
ERRORS_RAD = (0.25, 0.5, 1.0, 1.5)
SHOWN_S = 4.0
"""How much of a held-out trajectory is drawn [s]."""
DPI = 80
COLORS_KEPT = 64
"""Of a picture, which makes its file a third as large."""


def draw_fit(path: Path, fit: FitResult) -> None:
    """Measured and predicted torque over time, against each other, and the distribution of the error.

    Raises:
        ArriveError: the picture cannot be written.
    """
    figure = Figure(figsize=(12, 7), layout="constrained")
    over_time, against, errors = figure.subplot_mosaic([["time", "time"], ["against", "errors"]]).values()
    trajectory, predicted = fit.test[0], fit.predicted[0]
    steps = round(SHOWN_S / trajectory.period_s)
    time = np.arange(len(trajectory.torque[:steps])) * trajectory.period_s
    over_time.plot(time, trajectory.torque[:steps], color="black", label="measured")
    over_time.plot(time, predicted[:steps], color=COLORS[1], linestyle="--", label="predicted")
    over_time.set(xlabel="time [s]", ylabel="torque [N m]", title=f"held out: {trajectory.name}")
    over_time.legend(loc="upper right")
    measured, guessed = np.concatenate([t.torque for t in fit.test]), np.concatenate(fit.predicted)
    against.plot(measured, guessed, ".", markersize=1, color=COLORS[0])
    against.plot([measured.min(), measured.max()], [measured.min(), measured.max()], color="black", linewidth=0.8)
    against.set(xlabel="measured [N m]", ylabel="predicted [N m]", title="all held-out steps")
    errors.hist(guessed - measured, bins=81, color=COLORS[0])
    errors.set(
        xlabel="predicted minus measured [N m]",
        ylabel="steps",
        yscale="log",
        title=f"RMS {fit.errors.rms_nm:.2f} N m, {fit.errors.share:.1%} of the range",
    )
    _save(figure, path)


def draw_responses(path: Path, drives: Sequence[DriveModel], motor: Motor, inertia: float) -> None:
    """Step and frequency response and the torque-speed plane of several drives side by side.

    Args:
        motor: whose limits cut the drives' torques.
        inertia: of the load that the step turns, the rotor included [kg m^2].

    Raises:
        ArriveError: the picture cannot be written.
    """
    figure = Figure(figsize=(13, 7), layout="constrained")
    panels = figure.subplots(2, 3)
    for drive, color in zip(drives, COLORS, strict=False):
        style = {"color": color, "label": drive.name, "linewidth": 1.4}
        time, torque = locked_step(drive, motor, LOCKED_STEP_RAD, 0.15)
        panels[0, 0].step(1e3 * time, torque, where="post", **style)
        panels[0, 1].plot(*loaded_step(drive, motor, LOADED_STEP_RAD, inertia, 1.0), **style)
        _draw_frequencies(panels[1, 0], panels[1, 1], drive, style)
    panels[0, 0].set(xlabel="time [ms]", ylabel="torque [N m]", title=f"joint held, target jumps {LOCKED_STEP_RAD} rad")
    panels[0, 1].axhline(LOADED_STEP_RAD, color="grey", linewidth=0.8, linestyle=":")
    panels[0, 1].set(
        xlabel="time [s]", ylabel="position [rad]", title=f"{inertia:g} kg m², target jumps {LOADED_STEP_RAD} rad"
    )
    panels[1, 0].set(xscale="log", ylim=(0, None), ylabel="torque per target [N m/rad]")
    panels[1, 1].set(xscale="log", ylabel="phase [degrees]")
    for panel in panels[1, :2]:
        panel.set(xlabel="frequency [Hz]", title=f"joint held, target is a sine of {SINE_RAD} rad")
    for panel, drive, color in zip(panels[:, 2], drives[:2], COLORS, strict=False):
        _draw_plane(panel, drive, motor, color)
    panels[1, 2].set_visible(len(drives) > 1)
    panels[0, 0].legend(loc="lower right", fontsize="small")
    for panel in panels.flat:
        panel.grid(alpha=0.3)
    _save(figure, path)


def _draw_frequencies(gain: Axes, phase: Axes, drive: DriveModel, style: dict[str, Any]) -> None:
    frequencies = np.geomspace(0.5, min(50.0, 0.4 / drive.period_s), 30)
    answer = frequency_response(drive, frequencies, SINE_RAD)
    gain.plot(frequencies, np.abs(answer), **style)
    phase.plot(frequencies, np.degrees(np.unwrap(np.angle(answer))), **style)


def _draw_plane(panel: Axes, drive: DriveModel, motor: Motor, color: str) -> None:
    """Torque over speed for some position errors, before and after clipping, with the clip's limits."""
    speeds = np.linspace(-1.3 * motor.no_load_speed, 1.3 * motor.no_load_speed, 53)
    lowest, highest = TorqueClip([motor], drive.clip).limits(speeds)
    bound = 1.6 * motor.stall_torque
    panel.fill_between(speeds, np.maximum(lowest, -bound), np.minimum(highest, bound), color="black", alpha=0.08)
    for error in (*ERRORS_RAD, *(-error for error in ERRORS_RAD)):
        free, cut = torque_at_speed(drive, motor, error, speeds)
        panel.plot(speeds, free, color=color, linewidth=0.7, linestyle=":")
        panel.plot(speeds, cut, color=color, linewidth=1.2)
    errors = ", ".join(f"{error:g}" for error in ERRORS_RAD)
    panel.set(
        xlabel=f"speed [rad/s]; errors of ±{errors} rad",
        ylabel="torque [N m]",
        ylim=(-bound, bound),
        title=f"{drive.name}\ndotted before the clip `{drive.clip}`",
    )


def _save(figure: Figure, path: Path) -> None:
    figure.dpi = DPI
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").quantize(COLORS_KEPT)
    with whole(path) as file:
        picture.save(file, format="png", optimize=True)
