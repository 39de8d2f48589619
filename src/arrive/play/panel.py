"""The page's controls and messages."""

import math
from collections.abc import Callable
from typing import Any, Literal, TypeVar

import viser

from arrive.drive.pace import Pace
from arrive.errors import ArriveError
from arrive.play.history import History
from arrive.play.playground import DURATION_S, DURATIONS_S, FASTEST_PUSH, Playground
from arrive.play.plots import Plots
from arrive.play.skills import Skill, choices, open_skill
from arrive.play.status import status_html
from arrive.play.stick import CENTRE, page_html, parse_stick, stick_html
from arrive.terrain import FAMILIES, Family, Layout
from arrive.terrain.ground import Ground, varies

Request = Callable[[Playground], None]
Value = TypeVar("Value")
LAYOUTS: dict[str, Layout] = {"one way, to be crossed": "evaluation", "all around, as in training": "training"}
AWAY, OWN = "away from me", "where the robot looks"
HELP = (
    "Click on the ground or drag the target to send the robot there. Drive with the stick, the arrow keys (with shift "
    "at half speed) or a gamepad. `G` go, `R` reset, `P` push, `M` slow motion, `space` pause. The mouse and W A S D "
    "move the camera."
)
PLOTS_WIDTH = 280
"""Width of the panel with the plots [px]."""
SLOWEST, SLOW = 0.1, 0.2
"""Lowest speed of the simulation, and the speed of the slow-motion button; 1 is real time."""
BRAND = (224, 122, 31)


class Panel:
    """The controls. Changes of the simulation are queued for the thread that runs it."""

    def __init__(self, server: viser.ViserServer, playground: Playground, post: Callable[[Request], None]):
        """Add everything to the page.

        Args:
            post: queues a request, which is carried out between two control steps.
        """
        self._post, self._gui = post, server.gui
        self._driver: int | None = None
        """The browser that last moved the stick."""
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=BRAND, control_width="small")
        gui.main_panel.dock_right()
        gui.add_html(page_html())
        self._status = gui.add_html("")
        self._add_actions(gui)
        self._add_skill(gui)
        with gui.add_folder("Drive"):
            self._add_stick(gui)
        with gui.add_folder("More", expand_by_default=False):
            self._add_more(gui)
            gui.add_markdown(HELP)
        plots = gui.add_panel()
        self._plots_tab = plots.add_tab("Plots")
        plots.dock_left()
        plots.set_width(PLOTS_WIDTH)
        plots.minimize()
        self._plots: Plots | None = None
        self.show(playground)
        server.on_client_disconnect(self._let_go)

    @property
    def factor(self) -> float:
        """Requested ratio of simulated to real time, 0 to 1."""
        return 0.0 if self._pause.value else _within(self._speed.value, SLOWEST, 1.0)

    @property
    def follow(self) -> bool:
        """Whether the camera stays with the robot."""
        return self._follow.value

    @property
    def trail(self) -> bool:
        """Whether the feet leave a trail."""
        return self._trail.value

    @property
    def duration_s(self) -> float:
        """Time that the robot gets to reach a target [s]."""
        return _within(self._duration.value, *DURATIONS_S)

    def send(self, x: float, y: float) -> None:
        """Request that the robot walks to a point [m]."""
        duration_s = self.duration_s
        self._post(lambda playground: playground.send(x, y, duration_s))

    def show(self, playground: Playground) -> None:
        """Set the controls to the playground's policy and ground."""
        family, value = playground.ground.family, playground.ground.value
        self._show_skill(playground.skill)
        _set(self._terrain, family.name)
        _set(self._layout, next(label for label, layout in LAYOUTS.items() if layout == playground.ground.layout))
        self._value.visible = varies(family)
        if varies(family):
            self._value.label, self._value.precision = parameter_words(family), slider_digits(family)
            self._value.min, self._value.max = family.lowest, family.highest
            self._value.step = 10.0 ** -slider_digits(family)
            _set(self._value, value)
        robot = playground.robot.robot
        if self._plots is not None:
            self._plots.remove()
        with self._plots_tab:
            self._plots = Plots(self._gui, robot.joint_names, robot.foot_bodies)

    def update(self, playground: Playground, pace: Pace, history: History) -> None:
        """Update status and plots."""
        self._status.content = status_html(playground, pace)
        assert self._plots is not None, "show() comes first"
        self._plots.update(history, playground.time_s)

    def _add_actions(self, gui: viser.GuiApi) -> None:
        _on_press(gui, "Go", "G", lambda: self._go(), color=BRAND)
        _on_press(gui, "Slow motion", "M", self._toggle_slow, color="gray")
        _on_press(gui, "Reset", "R", lambda: self._post(Playground.reset), color="gray")

    def _go(self) -> None:
        duration_s = self.duration_s
        self._post(lambda playground: playground.go(duration_s))

    def _toggle_slow(self) -> None:
        _set(self._speed, SLOW if self._speed.value > SLOW else 1.0)

    def _add_skill(self, gui: viser.GuiApi) -> None:
        self._robot = gui.add_dropdown("Robot", ("",), visible=False)
        self._policy = gui.add_dropdown("Policy", ("",))
        self._terrain = gui.add_dropdown("Terrain", tuple(FAMILIES))
        self._value = gui.add_slider("Value", min=0.0, max=1.0, step=0.01, initial_value=0.0)
        self._robot.on_update(_by_a_person(self._change_robot))
        self._policy.on_update(_by_a_person(self._change_policy))
        self._terrain.on_update(_by_a_person(self._change_terrain))
        self._value.on_update(_by_a_person(self._change_value))

    def _show_skill(self, current: Skill) -> None:
        """Show the policies for the current robot, and the robots if there are several."""
        self._choices = choices(current)
        robots = tuple(sorted({choice.robot for choice in self._choices}))
        mine = next(choice for choice in self._choices if choice.name == current.name)
        self._robot.options, self._robot.visible = robots, len(robots) > 1
        _set(self._robot, mine.robot)
        self._policy.options = tuple(choice.label for choice in self._choices if choice.robot == mine.robot)
        _set(self._policy, mine.label)

    def _change_robot(self) -> None:
        self._run(next(choice.name for choice in self._choices if choice.robot == self._robot.value))

    def _change_policy(self) -> None:
        self._run(next(choice.name for choice in self._choices if choice.label == self._policy.value))

    def _run(self, name: str) -> None:
        """Load a policy in this thread, which belongs to the page, so that the simulation goes on meanwhile."""
        layout = LAYOUTS[self._layout.value]
        try:
            skill = open_skill(name)
            ground = skill.ground(layout)
        except ArriveError as error:
            message = str(error)
            self._post(lambda playground: _refuse(message))
            return
        self._post(lambda playground: playground.change(skill, ground))

    def _change_terrain(self) -> None:
        family, layout = FAMILIES[self._terrain.value], LAYOUTS[self._layout.value]

        def change(playground: Playground) -> None:
            playground.change(playground.skill, Ground(family, playground.skill.value(family.name), layout))

        self._post(change)

    def _change_value(self) -> None:
        family, layout = FAMILIES[self._terrain.value], LAYOUTS[self._layout.value]
        value = _within(self._value.value, family.lowest, family.highest)
        self._post(lambda playground: playground.change(playground.skill, Ground(family, value, layout)))

    def _add_stick(self, gui: viser.GuiApi) -> None:
        gui.add_html(stick_html())
        self._stick = gui.add_text(
            "Stick", CENTRE, hint="forward and left, -1 to 1; written by stick, keys and gamepad"
        )
        self._frame = gui.add_dropdown("Forward is", (AWAY, OWN), hint="Direction of the stick's upper end")

        @self._stick.on_update
        def _(event: viser.GuiEvent[viser.GuiTextHandle]) -> None:
            if event.client is not None and (stick := parse_stick(self._stick.value)) is not None:
                self._driver = event.client_id
                heading = view_heading(event.client) if self._frame.value == AWAY else None
                self._post(lambda playground: playground.drive(*stick, heading))

    def _let_go(self, client: viser.ClientHandle) -> None:
        """Release the stick if the browser that moved it is closed."""
        if client.client_id == self._driver:
            self._driver = None
            _set(self._stick, CENTRE)
            self._post(lambda playground: playground.drive(0.0, 0.0))

    def _add_more(self, gui: viser.GuiApi) -> None:
        self._duration = gui.add_slider(
            "Time [s]", min=DURATIONS_S[0], max=DURATIONS_S[1], step=0.5, initial_value=DURATION_S
        )
        self._layout = gui.add_dropdown("Layout", tuple(LAYOUTS))
        self._layout.on_update(_by_a_person(self._change_value))
        self._speed = gui.add_slider("Speed of time", min=SLOWEST, max=1.0, step=0.1, initial_value=1.0)
        self._pause = gui.add_checkbox("Pause", False)
        self._follow = gui.add_checkbox("Follow", True)
        self._trail = gui.add_checkbox("Trail", True)
        push = gui.add_slider("Push [m/s]", min=0.2, max=FASTEST_PUSH, step=0.2, initial_value=1.0)
        _on_press(
            gui,
            "Push",
            "P",
            lambda: self._post(lambda playground: playground.push(_within(push.value, 0.2, FASTEST_PUSH))),
            color="gray",
        )
        pause = gui.add_command("Pause", hotkey="space")

        @pause.on_trigger
        def _(_: object) -> None:
            _set(self._pause, not self._pause.value)


def parameter_words(family: Family) -> str:
    """A family's parameter with its unit, such as "Width [m]"."""
    return f"{family.parameter.capitalize()} [{family.unit}]" if family.unit else family.parameter.capitalize()


def slider_digits(family: Family) -> int:
    """Decimal places of a slider, so that it has at least twenty steps."""
    return max(0, -math.floor(math.log10((family.highest - family.lowest) / 20.0)))


def view_heading(client: viser.ClientHandle) -> float:
    """Heading of a browser's camera, from the world's x axis [rad]."""
    x, y, _ = client.camera.look_at - client.camera.position
    return math.atan2(y, x)


def _within(value: float, low: float, high: float) -> float:
    """A number from a browser, clamped to its range; `low` for NaN."""
    return min(max(low, value), high)


def _refuse(message: str) -> None:
    raise ArriveError(message)


def _set(control: viser.GuiInputHandle[Value], value: Value) -> None:
    """Set the value of a control. mypy does not find viser's setter, which is defined apart from the property."""
    control.value = value  # type: ignore[misc]


def _by_a_person(act: Callable[[], None]) -> Callable[[viser.GuiEvent[Any]], None]:
    """A callback that acts when a person changes a control, and not when this program does."""

    def react(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            act()

    return react


def _on_press(
    gui: viser.GuiApi,
    label: str,
    hotkey: Literal["G", "M", "P", "R"],
    act: Callable[[], None],
    color: Literal["gray"] | tuple[int, int, int],
) -> None:
    """Add a button and a hotkey for the same action."""
    gui.add_button(f"{label} ({hotkey})", color=color).on_click(lambda _: act())
    gui.add_command(label, hotkey=hotkey).on_trigger(lambda _: act())
