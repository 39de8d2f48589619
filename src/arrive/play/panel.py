"""What a person can set and press, and what they are told."""

import math
from collections.abc import Callable

import viser

from arrive.play.history import History
from arrive.play.pace import Pace
from arrive.play.playground import LEVELS, Playground
from arrive.play.plots import Plots
from arrive.play.stick import CENTRE, parse_stick, stick_html
from arrive.terrain import FAMILIES

Request = Callable[[Playground], None]
HELP = (
    "Drag the target or click on the ground. Drive with the stick, the arrow keys (with shift at half speed) or a "
    "gamepad. `R` reset, `P` push, `G` go again, `space` pause. W A S D and the mouse move the camera."
)
PLOTS_WIDTH = 320
"""Of the panel with the plots [px]."""


class Panel:
    """The controls; all that touches the simulation is posted to the thread that owns it."""

    def __init__(self, server: viser.ViserServer, playground: Playground, post: Callable[[Request], None]):
        """Add everything to the page.

        Args:
            post: takes a request, to be carried out between two control steps.
        """
        self._post = post
        self._driver: int | None = None
        """The browser that last moved the stick."""
        gui = server.gui
        gui.main_panel.dock_right()
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(224, 122, 31))
        self._status = gui.add_markdown("")
        with gui.add_folder("Target"):
            self._add_target(gui)
        with gui.add_folder("Stick"):
            self._add_stick(gui)
        with gui.add_folder("Ground"):
            self._add_ground(gui, playground)
        with gui.add_folder("World"):
            self._add_world(gui)
        gui.add_markdown(HELP)
        plots = gui.add_panel()
        with plots.add_tab("Plots"):
            robot = playground.robot.robot
            self._plots = Plots(gui, robot.joint_names, robot.foot_bodies)
        plots.dock_left()
        plots.set_width(PLOTS_WIDTH)
        server.on_client_disconnect(self._let_go)

    @property
    def factor(self) -> float:
        """Simulated per real time that is asked for."""
        return 0.0 if self._pause.value else self._speed.value

    @property
    def follow(self) -> bool:
        """Whether the camera stays with the robot."""
        return self._follow.value

    @property
    def duration_s(self) -> float:
        """Time that the robot is given to get to a target [s]."""
        return self._duration.value

    def send(self, x: float, y: float) -> None:
        """Ask for the robot to go to a place [m]."""
        duration_s = self.duration_s
        self._post(lambda playground: playground.send(x, y, duration_s))

    def update(self, playground: Playground, pace: Pace, history: History) -> None:
        """Say how things stand."""
        self._status.content = _status(playground, pace)
        self._parameter.content = playground.ground
        self._plots.update(history, playground.time_s)

    def _add_target(self, gui: viser.GuiApi) -> None:
        self._duration = gui.add_slider("Time [s]", min=1.0, max=12.0, step=0.5, initial_value=5.0)
        _on_press(gui, "Go again", "G", lambda: self._post(lambda playground: again(playground, self.duration_s)))

    def _add_stick(self, gui: viser.GuiApi) -> None:
        gui.add_html(stick_html())
        self._stick = gui.add_text("Forward, left", CENTRE, hint="-1 to 1 each; written by stick, keys and gamepad")
        self._frame = gui.add_dropdown(
            "Forward is", ("away from me", "where the robot looks"), hint="What the stick's upper end means"
        )

        @self._stick.on_update
        def _(event: viser.GuiEvent) -> None:
            if event.client is not None and (stick := parse_stick(self._stick.value)) is not None:
                self._driver = event.client_id
                heading = view_heading(event.client) if self._frame.value == "away from me" else None
                self._post(lambda playground: playground.drive(*stick, heading))

    def _let_go(self, client: viser.ClientHandle) -> None:
        """A browser that is closed lets the stick go."""
        if client.client_id == self._driver:
            self._driver, self._stick.value = None, CENTRE
            self._post(lambda playground: playground.drive(0.0, 0.0))

    def _add_ground(self, gui: viser.GuiApi, playground: Playground) -> None:
        self._terrain = gui.add_dropdown("Terrain", tuple(FAMILIES), initial_value=playground.terrain)
        self._level = gui.add_slider("Level", min=0, max=LEVELS - 1, step=1, initial_value=playground.level)
        self._parameter = gui.add_markdown("")

        def change(event: viser.GuiEvent) -> None:
            if event.client is not None:
                terrain, level = self._terrain.value, self._level.value
                self._post(lambda playground: playground.change_terrain(terrain, level))

        self._terrain.on_update(change)
        self._level.on_update(change)

    def _add_world(self, gui: viser.GuiApi) -> None:
        self._speed = gui.add_slider("Speed of time", min=0.1, max=1.0, step=0.1, initial_value=1.0)
        self._pause = gui.add_checkbox("Pause", False)
        self._follow = gui.add_checkbox("Follow", False)
        push = gui.add_slider("Push [m/s]", min=0.2, max=3.0, step=0.2, initial_value=1.0)
        _on_press(gui, "Push", "P", lambda: self._post(lambda playground: playground.push(push.value)))
        _on_press(gui, "Reset", "R", lambda: self._post(Playground.reset))
        pause = gui.add_command("Pause", hotkey="space")

        @pause.on_trigger
        def _(_) -> None:
            self._pause.value = not self._pause.value


def again(playground: Playground, duration_s: float) -> None:
    """Send the robot to its target once more, with new time; without a target nothing happens."""
    if playground.target is not None:
        x, y, _ = playground.target.position_w
        playground.send(x, y, duration_s)


def view_heading(client: viser.ClientHandle) -> float:
    """Horizontal direction in which a browser's camera looks, from the world's x axis [rad]."""
    x, y, _ = client.camera.look_at - client.camera.position
    return math.atan2(y, x)


def _on_press(gui: viser.GuiApi, label: str, hotkey: str, act: Callable[[], None]) -> None:
    """A button and a key that do the same."""
    gui.add_button(f"{label} ({hotkey})").on_click(lambda _: act())
    gui.add_command(label, hotkey=hotkey).on_trigger(lambda _: act())


def _status(playground: Playground, pace: Pace) -> str:
    command, target = playground.command, playground.target
    lines = [f"**{command.mode}**{': ' if command.reason else ''}{command.reason}"]
    if target is not None:
        left = max(0.0, target.arrive_at_s - playground.time_s)
        lines.append(f"{playground.distance:.2f} m to the target, {left:.1f} s left")
    lines.append(f"{playground.time_s:.1f} s at {pace.factor:g} x real time, falls: {playground.falls}")
    return "  \n".join(lines) + "\n\n" + "\n".join(f"- {message}" for message in playground.messages)
