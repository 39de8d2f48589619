"""The web server: viser's, with our checks of requests (`door`), connections (`connection`) and messages (`guard`)."""

import contextlib
import io
import logging
import socket
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from arrive.errors import ArriveError
from arrive.play.connection import Handler, limited, with_room
from arrive.play.door import Door, door_of
from arrive.play.guard import LARGEST_MESSAGE, Guard

FORBIDDEN, UNAVAILABLE = 403, 503
Process = Callable[[ServerConnection, Request], Response | None]


def open_server(host: str, port: int) -> tuple[viser.ViserServer, Door]:
    """Serve the page.

    Raises:
        ArriveError: the port is in use, the host is empty or not an address of this machine, or the checks cannot be
            installed in this version of viser.
    """
    door = door_of(host, port)
    # viser would silently take another port, and search endlessly if the host is wrong.
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.create_server((host, port), family=family):
            pass
    except (OSError, OverflowError, TypeError, UnicodeError) as error:  # TypeError: of names that cannot be encoded
        raise ArriveError(
            f"cannot listen on {host!r} port {port}: {error}. Choose another with --host or --port."
        ) from error
    guard = Guard()
    # viser warns when a browser leaves while it is being sent something.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
    # viser always prints a box with its own addresses.
    with _through(door, guard) as taken, contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="arrive", verbose=False)
    if not taken or server.get_port() != port:
        server.stop()
        raise ArriveError(f"cannot serve the page safely on port {port} with viser {viser.__version__}")
    guard.server = server
    return server, door


@contextlib.contextmanager
def _through(door: Door, guard: Guard) -> Iterator[list[bool]]:
    """Install the checks in every websockets server that starts meanwhile. viser offers no way to pass them.

    Yields:
        A list that is no longer empty when a server has started with the checks.
    """
    serve, taken = websockets.asyncio.server.serve, []
    quiet = logging.getLogger("arrive.play.server")
    # A refused request is not a fault of this program, so websockets must not print a traceback.
    quiet.addHandler(logging.NullHandler())
    quiet.propagate = False

    def serve_guarded(handle: Handler, *args: Any, process_request: Process, **options: Any) -> Any:
        taken.append(True)
        options |= {"max_size": LARGEST_MESSAGE, "create_connection": limited(guard), "logger": quiet}
        return serve(with_room(handle), *args, process_request=_checked(door, guard, process_request), **options)

    websockets.asyncio.server.serve = serve_guarded  # type: ignore[misc, assignment]
    try:
        yield taken
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _checked(door: Door, guard: Guard, answer: Process) -> Process:
    """Answer only the requests that the door allows, once the server is complete."""

    def process(connection: ServerConnection, request: Request) -> Response | None:
        refusal = door.refusal(request.headers, request.path)
        if refusal:
            return connection.respond(FORBIDDEN, f"{refusal}\n")
        if guard.server is None:
            return connection.respond(UNAVAILABLE, "the page is starting\n")
        response = answer(connection, request)
        if response is not None:
            for name, value in door.welcome(request.path).items():
                response.headers[name] = value
        return response

    return process
