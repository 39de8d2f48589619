"""One simulation for all browsers: the thread that steps it, draws it and carries out what people ask for."""

import contextlib
import io
import math
import queue
import socket
import threading
import time
from collections.abc import Callable, Hashable

import numpy as np
import viser

from arrive.errors import ArriveError
from arrive.play.history import History
from arrive.play.pace import Pace
from arrive.play.panel import Panel, Request
from arrive.play.playground import Playground
from arrive.play.scene import Scene

DRAW_PERIOD_S = 1 / 30
"""Between pictures [s]."""
PANEL_PERIOD_S = 0.2
"""Between updates of status and plots [s]."""
READING_STEPS = 2
"""Control steps between readings in the plots."""
NAP_S = 0.002
"""The thread looks for work this often [s]."""


def open_server(host: str, port: int) -> viser.ViserServer:
    """Serve the page.

    Raises:
        ArriveError: the port is in use, or the host is not this machine's.
    """
    # viser would silently take another port, and look for one for ever where the host is wrong.
    try:
        with socket.create_server((host, port)):
            pass
    except (OSError, OverflowError) as error:
        raise ArriveError(f"cannot listen on {host} port {port}: {error}. Choose another with --port.") from error
    # Whatever it is told, viser prints a box with its own addresses.
    with contextlib.redirect_stdout(io.StringIO()):
        return viser.ViserServer(host=host, port=port, label="arrive", verbose=False)


class Ticker:
    """Does something every now and then, but only if anything has changed."""

    def __init__(self, period_s: float, act: Callable[[], None]):
        """Do it at the first tick.

        Args:
            period_s: least time between two times [s].
        """
        self._period_s, self._act = period_s, act
        self._next_s = -math.inf
        self._seen: Hashable = None

    def tick(self, now_s: float, state: Hashable) -> None:
        """Do it now if it is time and `state` is another than when it was done last."""
        if now_s >= self._next_s and state != self._seen:
            self._act()
            self._seen, self._next_s = state, now_s + self._period_s


class Session:
    """What the browsers share. Only the thread that runs it touches the simulation."""

    def __init__(self, server: viser.ViserServer, playground: Playground):
        """Put everything on the page; nothing moves until `run`."""
        self.playground = playground
        self._server = server
        task = playground.controller.policy.task
        self._requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self._drawn_robot, self._drawn_target = playground.robot, playground.target
        self._scene = Scene(server, playground.robot, task.arrival_radius_m, task.target_height_m)
        self._panel = Panel(server, playground, self.post)
        self._history = History(READING_STEPS * playground.control_dt)
        self._steps = self._answered = 0
        self._picture = Ticker(DRAW_PERIOD_S, self._draw)
        self._display = Ticker(PANEL_PERIOD_S, lambda: self._panel.update(self.playground, self.pace, self._history))
        self.pace = Pace(playground.control_dt)
        """The simulation's clock, which also says how much time was lost."""
        self._listen()

    def post(self, request: Request) -> None:
        """Have a request carried out between two control steps."""
        self._requests.put(request)

    def run(self, stop: threading.Event) -> None:
        """Run until told to stop."""
        while not stop.is_set():
            self._carry_out()
            self.pace.factor = self._panel.factor
            for _ in range(self.pace.steps_due(time.monotonic())):
                self._step()
            state = (self._steps, self._answered, self.pace.factor, self._panel.follow)
            self._picture.tick(time.monotonic(), state)
            self._display.tick(time.monotonic(), state)
            stop.wait(NAP_S)

    def _carry_out(self) -> None:
        while not self._requests.empty():
            try:
                self._requests.get()(self.playground)
            except ArriveError as error:
                self.playground.messages.append(str(error))
            self._answered += 1

    def _step(self) -> None:
        self.playground.step()
        self._steps += 1
        if self._steps % READING_STEPS == 0:
            self._history.append(self.playground.read())

    def _draw(self) -> None:
        """Links always; ground and target only when they are others, for a person may be dragging the target."""
        robot, target = self.playground.robot, self.playground.target
        if robot is not self._drawn_robot:
            self._scene.show_ground(robot)
            self._drawn_robot = robot
        if target is not self._drawn_target:
            self._scene.show_target(target.position_w if target else None)
            self._drawn_target = target
        self._scene.update(robot, self._panel.follow)

    def _listen(self) -> None:
        """To the two ways of setting a target."""

        @self._scene.gizmo.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            if event.phase == "end":
                x, y, _ = event.target.position
                self._panel.send(float(x), float(y))

        @self._server.scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            origin, direction = self._scene.in_world(event.ray_origin), np.array(event.ray_direction)

            def send_there(playground: Playground) -> None:
                hit = playground.hit(origin, direction)
                if hit is not None:
                    playground.send(hit[0], hit[1], self._panel.duration_s)

            self.post(send_there)
