"""One simulation for all browsers, with the thread that steps it, draws it and carries out requests."""

import math
import queue
import threading
import time
from collections.abc import Callable, Hashable

import numpy as np
import viser

from arrive.drive.pace import Pace
from arrive.errors import ArriveError
from arrive.play.history import History
from arrive.play.panel import Panel, Request
from arrive.play.playground import Playground
from arrive.play.scene import IDLE, REACHED, SENT, Scene
from arrive.play.trail import Trail

DRAW_PERIOD_S = 1 / 30
"""Time between pictures [s]."""
PANEL_PERIOD_S = 0.2
"""Time between updates of status and plots [s]."""
TRAIL_PERIOD_S = 0.1
"""Time between updates of the trail of the feet [s]."""
READING_STEPS = 2
"""Control steps between two samples of the plots."""
NAP_S = 0.002
"""Time that the thread sleeps when there is nothing to do [s]."""


class Ticker:
    """Calls a function periodically, but only if something has changed."""

    def __init__(self, period_s: float, act: Callable[[], None]):
        """The first tick calls the function.

        Args:
            period_s: shortest time between two calls [s].
        """
        self._period_s, self._act = period_s, act
        self._next_s = -math.inf
        self._seen: Hashable = None

    def tick(self, now_s: float, state: Hashable) -> None:
        """Call the function if the period is over and `state` has changed since the last call."""
        if now_s >= self._next_s and state != self._seen:
            self._act()
            self._seen, self._next_s = state, now_s + self._period_s


class Session:
    """The state that all browsers share. Only the thread of `run` may touch the simulation."""

    def __init__(self, server: viser.ViserServer, playground: Playground):
        """Put everything on the page. The simulation starts with `run`."""
        self.playground = playground
        self._server = server
        self._requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self._scene = Scene(server, playground)
        self._panel = Panel(server, playground, self.post)
        self._start_over()
        self._drawn_target: Hashable = None
        self._looked_at: Hashable = (playground.ground.family, playground.ground.layout)
        self._steps = self._answered = 0
        self._tickers = (
            Ticker(DRAW_PERIOD_S, self._draw),
            Ticker(TRAIL_PERIOD_S, self._draw_trail),
            Ticker(PANEL_PERIOD_S, lambda: self._panel.update(self.playground, self.pace, self._history)),
        )
        self.pace = Pace(playground.control_dt)
        """Keeps the simulation in real time, and measures how much time was lost."""
        self._listen()

    def post(self, request: Request) -> None:
        """Queue a request, which is carried out between two control steps."""
        self._requests.put(request)

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set."""
        while not stop.is_set():
            self._carry_out()
            self.pace.factor = self._panel.factor
            for _ in range(self.pace.steps_due(time.monotonic())):
                self._step()
            panel = self._panel
            state = (self._steps, self._answered, self.pace.factor, panel.follow, panel.trail)
            for ticker in self._tickers:
                ticker.tick(time.monotonic(), state)
            stop.wait(NAP_S)

    def _carry_out(self) -> None:
        while not self._requests.empty():
            try:
                self._requests.get()(self.playground)
            except ArriveError as error:
                self.playground.messages.append(str(error))
                self._panel.show(self.playground)
            self._answered += 1
        if self._drawn_robot is not self.playground.robot:
            self._scene.show(self.playground)
            self._panel.show(self.playground)
            self._start_over()
            self._look()

    def _look(self) -> None:
        """On a new terrain family, point the cameras along the way. On another value of the same one, leave them."""
        ground = self.playground.ground
        if (ground.family, ground.layout) == self._looked_at:
            return
        self._looked_at = (ground.family, ground.layout)
        for client in self._server.get_clients().values():
            self._scene.look(client, self.playground)

    def _start_over(self) -> None:
        """Clear plots and trail for another robot or ground."""
        self._drawn_robot = self.playground.robot
        self._trail = Trail(self.playground.control_dt)
        self._history = History(READING_STEPS * self.playground.control_dt)

    def _step(self) -> None:
        self.playground.step()
        self._steps += 1
        if self._steps % READING_STEPS == 0:
            self._history.append(self.playground.read())
        self._trail.append(self.playground.feet())

    def _draw(self) -> None:
        """Draw the links. Draw the target only if it has changed, because a person may be dragging it."""
        playground = self.playground
        colour = IDLE if playground.target is None else REACHED if playground.is_there else SENT
        if (playground.aim, colour) != self._drawn_target:
            self._scene.show_target(playground.aim, colour)
            self._drawn_target = (playground.aim, colour)
        self._scene.update(self.playground.robot, self._panel.follow)

    def _draw_trail(self) -> None:
        self._scene.show_trail(self._trail, len(self.playground.robot.robot.foot_sites), self._panel.trail)

    def _listen(self) -> None:
        """Register callbacks: for new browsers, and for a target that is dragged or clicked."""

        @self._server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            self.post(lambda playground: self._scene.look(client, playground))

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
