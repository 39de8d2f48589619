"""A served page of `arrive play`, and what a browser's script needs to talk to it."""

import asyncio
import contextlib
import threading

import msgspec
import viser
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from arrive.play.playground import Playground
from arrive.play.server import open_server
from arrive.play.session import Session
from arrive.play.skills import open_skill
from arrive.terrain.ground import ground_of
from ports import free_port

PROTOCOL = f"viser-v{viser.__version__}"
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (1.0, 2.0, 3.0),
    "fov": 1.0,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
CLICK = {
    "type": "ScenePointerMessage",
    "event_type": "click",
    "ray_origin": (2.0, 0.0, 5.0),
    "ray_direction": (0.0, 0.0, -1.0),
    "screen_pos": ((0.5, 0.5),),
    "modifier": None,
}
DRAG = {
    "type": "TransformControlsUpdateMessage",
    "name": "/world/target",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (1.0, 1.0, 0.5),
    "owner": "",
}


class Page:
    """A running session, and what a browser needs to talk to it."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0):
        self.port = port or free_port()
        self.playground = Playground(open_skill(None), ground_of("flat"))
        self.server, self.door = open_server(host, self.port)
        self.session = Session(self.server, self.playground)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.session.run, args=(self._stop,))
        self._thread.start()

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def connect(self, origin: str | None = None, **options):
        """A connection as the page's script makes one."""
        options.setdefault("additional_headers", {"Origin": origin or self.origin})
        return connect(f"ws://127.0.0.1:{self.port}/", subprotocols=[PROTOCOL], max_size=None, **options)

    def controls(self) -> dict[str, object]:
        return dict(self.server.gui._gui_input_handle_from_uuid)

    def alive(self) -> bool:
        """Whether requests are carried out."""
        done = threading.Event()
        self.session.post(lambda playground: done.set())
        return done.wait(10.0) and self._thread.is_alive()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.server.stop()


async def answers(page: Page, **options) -> bool:
    """Whether a new browser is sent the scene."""
    async with page.connect(**options) as browser:
        await browser.send(msgspec.msgpack.encode(CAMERA))
        return len(await asyncio.wait_for(browser.recv(), 10.0)) > 100


async def read_all(browser) -> None:
    """Take whatever the server sends, as a browser does."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            await browser.recv()
