"""Live plots of the last seconds: speed and distance, torques, feet on the ground."""

import numpy as np
import viser

from arrive.play.history import WINDOW_S, History

BLUE, ORANGE, GREEN, RED = "#2f6fb0", "#e07a1f", "#3a8f4d", "#b03a48"
DRIVES = {"HAA": BLUE, "HFE": ORANGE, "KFE": GREEN}
"""Colour of a joint's torque by the end of its name; others are red."""
LIFT = 0.6
"""Height of a foot's line while it touches, in rows."""
NO_TIME_AXIS = {"x": {"time": False}}


class Plots:
    """Three charts that share their time axis."""

    def __init__(self, gui: viser.GuiApi, joint_names: tuple[str, ...], foot_names: tuple[str, ...]):
        """Add empty charts to the page."""
        self._joints, self._feet = len(joint_names), len(foot_names)
        self._way = _chart(
            gui, "Speed [m/s], distance to the target [m]", [("speed", BLUE), ("distance", ORANGE)], legend=True
        )
        colours = [DRIVES.get(name[-3:], RED) for name in joint_names]
        self._torque = _chart(
            gui, "Torque [N m]: HAA blue, HFE orange, KFE green", list(zip(joint_names, colours, strict=True))
        )
        names = ", ".join(name.removesuffix("_FOOT") for name in foot_names)
        feet = list(zip(foot_names, (BLUE, ORANGE, GREEN, RED), strict=False))
        self._contact = _chart(gui, f"Feet on the ground, from above: {names}", feet)

    def update(self, history: History, now_s: float) -> None:
        """Show the history; time 0 is now."""
        time_s = history.time_s - now_s
        rows = np.arange(self._feet)[::-1, None]
        self._way.data = (time_s, history.speed, history.distance)
        self._torque.data = (time_s, *history.torque.T.reshape(self._joints, -1))
        self._contact.data = (time_s, *(rows + LIFT * history.contact.T.reshape(self._feet, -1)))


def _chart(gui: viser.GuiApi, title: str, lines: list[tuple[str, str]], legend: bool = False) -> viser.GuiUplotHandle:
    nothing = np.array([-WINDOW_S, 0.0])
    return gui.add_uplot(
        (nothing, *(np.zeros(2) for _ in lines)),
        ({}, *({"label": name, "stroke": colour, "width": 1.5} for name, colour in lines)),
        title=title,
        scales=NO_TIME_AXIS,
        legend={"show": legend},
        height=190 if legend else 160,
    )
