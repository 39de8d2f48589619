"""One simulation for all browsers: the thread that steps it, draws it and carries out what people ask for."""

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
"""Between pictures [s]."""
PANEL_PERIOD_S = 0.2
"""Between updates of status and plots [s]."""
TRAIL_PERIOD_S = 0.1
"""Between updates of the feet's trail [s]."""
READING_STEPS = 2
"""Control steps between readings in the plots."""
NAP_S = 0.002
"""The thread looks for work this often [s]."""


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
    """State that all browsers share. Only the thread that runs it touches the simulation."""

    def __init__(self, server: viser.ViserServer, playground: Playground):
        """Put everything on the page; nothing moves until `run`."""
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
        """Other terrain is looked at along the way; another value of the same leaves cameras where they are."""
        ground = self.playground.ground
        if (ground.family, ground.layout) == self._looked_at:
            return
        self._looked_at = (ground.family, ground.layout)
        for client in self._server.get_clients().values():
            self._scene.look(client, self.playground)

    def _start_over(self) -> None:
        """Another robot or ground has neither past nor trail."""
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
        """Links always; the target only when it is another, for a person may be dragging it."""
        playground = self.playground
        colour = IDLE if playground.target is None else REACHED if playground.is_there else SENT
        if (playground.aim, colour) != self._drawn_target:
            self._scene.show_target(playground.aim, colour)
            self._drawn_target = (playground.aim, colour)
        self._scene.update(self.playground.robot, self._panel.follow)

    def _draw_trail(self) -> None:
        self._scene.show_trail(self._trail, len(self.playground.robot.robot.foot_sites), self._panel.trail)

    def _listen(self) -> None:
        """To browsers that open the page, and to the two ways of setting a target."""

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
