"""`arrive play`: a robot in the browser."""

from __future__ import annotations

import importlib.util
import threading
from typing import TYPE_CHECKING

from arrive.errors import ArriveError

if TYPE_CHECKING:
    from arrive.cli import Play


def play(command: Play) -> None:
    """Serve the page until Ctrl-C or the time given, then say whether real time was kept."""
    for package in ("viser", "onnxruntime"):
        if importlib.util.find_spec(package) is None:
            raise ArriveError(f"this needs {package}: pip install 'arrive[play]'")
    from arrive.play.playground import Playground
    from arrive.play.session import Session, open_server
    from arrive.policies import open_policy

    playground = Playground(open_policy(command.policy), command.terrain, command.level)
    server = open_server(command.host, command.port)
    stop = threading.Event()
    session = Session(server, playground)
    try:
        print(f"play: http://{command.host}:{server.get_port()} (Ctrl-C ends it)", flush=True)
        if command.seconds is not None:
            threading.Timer(command.seconds, stop.set).start()
        session.run(stop)
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
        pace = session.pace
        kept = 1.0 - pace.dropped_s / max(pace.asked_s, 1e-9)
        print(f"simulated {kept:.1%} of the {pace.asked_s:.1f} s asked for; falls: {playground.falls}")
