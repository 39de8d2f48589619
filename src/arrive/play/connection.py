"""Limits what one connection may send, and how many connections there are.

Strangers may open thousands of connections, flood them or never read them. The page stays open for others meanwhile.
"""

import time
from asyncio import sleep
from collections.abc import Awaitable, Callable
from typing import Any

import viser
from websockets.asyncio.server import ServerConnection
from websockets.frames import CloseCode, Frame, Opcode
from websockets.protocol import State

from arrive.play.guard import CAMERA, Guard

PROTOCOL = f"viser-v{viser.__version__}"
"""Websocket protocol of the page that this server sends."""
MESSAGES_PER_S = 400
"""Messages of one connection are read at most this fast. The page sends up to about 100."""
OTHER_FRAMES_PER_S = 50
"""A connection with more frames than this that are no whole messages is closed. A browser answers a ping in 20 s."""
PATIENCE = 100
"""A connection is closed after this number of dropped messages."""
MOST_PAGES = 32
"""Number of open pages. Another one replaces the page that was heard from longest ago."""
MOST_SOCKETS = 256
"""Number of connections, pages and requests. Another one replaces the request that has waited longest."""
Handler = Callable[[Any], Awaitable[None]]


class LimitedConnection(ServerConnection):
    """A connection that receives only what a guard admits, at a limited rate."""

    guard: Guard
    heard_s = 0.0
    """When the last message was admitted, by the monotonic clock [s]."""
    _known = False
    _dropped = _second = _heard = _others = 0

    def connection_made(self, transport: Any) -> None:
        """Start the handshake, and close the oldest unfinished one if there are too many connections."""
        super().connection_made(transport)
        self.heard_s = time.monotonic()
        if len(self.server.handlers) > MOST_SOCKETS:
            waiting = (other for other in self.server.handlers if _is_in(other, State.CONNECTING))
            next(waiting, self).transport.abort()

    def process_event(self, event: Any) -> None:
        """Handle a request or a frame, and close connections that send too many frames that are no whole messages."""
        if isinstance(event, Frame) and not (event.opcode is Opcode.BINARY and event.fin):
            self._begin_second()
            self._others += 1
            if self._others > OTHER_FRAMES_PER_S:
                self.transport.abort()
                return
        super().process_event(event)

    async def recv(self, *args: Any, **kwargs: Any) -> Any:
        """The next message that is admitted. The first one is the camera's, by which viser knows the browser."""
        while True:
            raw = await super().recv(*args, **kwargs)
            await self._keep_pace()
            kind = self.guard.admitted(raw)
            if kind == CAMERA or (kind and self._known):
                self._known = True
                self.heard_s = time.monotonic()
                return raw
            self._dropped += 1
            if self._dropped > PATIENCE:
                # Without a closing handshake: the server would wait for the answer of a hostile client.
                self.transport.abort()

    async def _keep_pace(self) -> None:
        self._begin_second()
        self._heard += 1
        if self._heard > MESSAGES_PER_S:
            await sleep(1.0 - time.monotonic() % 1.0)

    def _begin_second(self) -> None:
        """Reset the counters of a second."""
        second = int(time.monotonic())
        if second != self._second:
            self._second, self._heard, self._others = second, 0, 0


def limited(guard: Guard) -> type[LimitedConnection]:
    """A class of connections with this guard."""
    return type("GuardedConnection", (LimitedConnection,), {"guard": guard})


def with_room(handle: Handler) -> Handler:
    """A handler of pages that makes room for every new page, and ends those of another version of viser."""

    async def handle_page(connection: LimitedConnection) -> None:
        if connection.subprotocol != PROTOCOL:
            await connection.close(CloseCode.PROTOCOL_ERROR, "this page is of another version: load it again")
            return
        others = [page for page in connection.server.handlers if page is not connection and _is_in(page, State.OPEN)]
        if len(others) >= MOST_PAGES:
            min(others, key=_heard_s).transport.abort()
        await handle(connection)

    return handle_page


def _is_in(connection: ServerConnection, state: State) -> bool:
    """Whether a connection is in a state, and is not being closed."""
    return connection.state is state and not connection.transport.is_closing()


def _heard_s(page: ServerConnection) -> float:
    assert isinstance(page, LimitedConnection)
    return page.heard_s
