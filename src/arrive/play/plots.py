"""Live plots of the recent past: speed and distance, torques, foot contacts."""

import numpy as np
import viser
from viser import uplot

from arrive.play.colours import PALETTE, hexadecimal, joint_kinds, leg_names, palette
from arrive.play.history import WINDOW_S, History

LIFT = 0.7
"""Height of a foot's line in contact; 1 is the distance between two lines."""
HEIGHT = 170
"""Height of a chart [px]."""


class Plots:
    """Three charts with the same time axis. Lines are coloured by joint kind and by foot."""

    def __init__(self, gui: viser.GuiApi, joint_names: tuple[str, ...], foot_names: tuple[str, ...]):
        """Add empty charts to the page."""
        self._joints, self._feet = len(joint_names), len(foot_names)
        colours = [hexadecimal(colour) for colour in PALETTE]
        way = [("speed [m/s]", colours[0]), ("distance to the target [m]", colours[1])]
        self._way = _chart(gui, "Speed and distance", way, _at_least(0.0, 1.5))
        kinds = joint_kinds(joint_names, foot_names)
        of_kind = dict(zip(dict.fromkeys(kinds), map(hexadecimal, palette(len(kinds))), strict=False))
        joints = [(name, of_kind[kind]) for name, kind in zip(joint_names, kinds, strict=True)]
        self._torque = _chart(gui, "Torques [N m]", joints, _at_least(-40.0, 40.0), legend=False)
        self._key = gui.add_html(_key(of_kind))
        feet = list(zip(leg_names(foot_names), map(hexadecimal, palette(self._feet)), strict=True))
        self._contact = _chart(gui, "Feet on the ground", feet, {"range": (-0.2, float(self._feet))})

    def update(self, history: History, now_s: float) -> None:
        """Plot the history. Time 0 is now."""
        time_s = history.time_s - now_s
        rows = np.arange(self._feet)[::-1, None]
        self._way.data = (time_s, history.speed, history.distance)
        self._torque.data = (time_s, *history.torque.T.reshape(self._joints, -1))
        self._contact.data = (time_s, *(rows + LIFT * history.contact.T.reshape(self._feet, -1)))

    def remove(self) -> None:
        """Take the charts off the page."""
        for part in (self._way, self._torque, self._key, self._contact):
            part.remove()


def _key(colours: dict[str, str]) -> str:
    """A legend: names in their colours."""
    words = (f'<span style="color:{colour};font-weight:600">{name}</span>' for name, colour in colours.items())
    return f'<div style="font-size:0.8em;padding:0 0.8em">{" ".join(words)}</div>'


def _at_least(low: float, high: float) -> uplot.Scale:
    """A scale that shows at least this range."""
    return {"range": {"min": {"soft": low, "mode": 1, "pad": 0.1}, "max": {"soft": high, "mode": 1, "pad": 0.1}}}


def _chart(
    gui: viser.GuiApi, title: str, lines: list[tuple[str, str]], scale: uplot.Scale, legend: bool = True
) -> viser.GuiUplotHandle:
    """A chart of lines given by name and colour."""
    nothing = np.array([-WINDOW_S, 0.0])
    return gui.add_uplot(
        (nothing, *(np.zeros(2) for _ in lines)),
        ({"label": "time [s]"}, *(uplot.Series(label=name, stroke=colour, width=1.5) for name, colour in lines)),
        title=title,
        scales={"x": {"time": False, "range": (-WINDOW_S, 0.0)}, "y": scale},
        legend={"show": legend, "live": False},
        height=HEIGHT,
        padding=(10, 24, 0, 0),
    )
