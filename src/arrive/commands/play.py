"""`arrive play`: a robot in the browser."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from arrive.commands.policies import need

if TYPE_CHECKING:
    from arrive.commands.options import Play
    from arrive.play.skills import Skill
    from arrive.terrain.ground import Ground


def run_play(command: Play) -> None:
    """Serve the page until Ctrl-C or the given time, then print the share of real time that was kept."""
    need("viser", "viser>=1.1,<2")
    need("onnxruntime")
    from arrive.play.follow import Follower
    from arrive.play.playground import Playground
    from arrive.play.server import open_server
    from arrive.play.session import Session

    playground = Playground(*_opening(command))
    server, door = open_server(command.host, command.port)
    stop = threading.Event()
    session = Session(server, playground)
    follower = Follower(playground.skill.name, session.post) if command.follow else None
    try:
        print(f"play: {door.address} (Ctrl-C to stop)", flush=True)
        if command.seconds is not None:
            timer = threading.Timer(command.seconds, stop.set)
            timer.daemon = True  # otherwise the program would wait for it after Ctrl-C
            timer.start()
        if follower is not None:
            threading.Thread(target=follower.run, args=(stop,), daemon=True).start()
        session.run(stop)
    except KeyboardInterrupt:
        pass
    finally:
        stop.set()
        server.stop()
        pace = session.pace
        kept = 1.0 - pace.dropped_s / max(pace.asked_s, 1e-9)
        print(f"simulated {kept:.1%} of {pace.asked_s:.1f} s in real time; falls: {playground.falls}")


def _opening(command: Play) -> tuple[Skill, Ground]:
    """The policy and its ground: the requested one, or the hardest that the policy solves."""
    from arrive.play.skills import open_skill
    from arrive.terrain.ground import Ground, ground_of

    skill = open_skill(command.policy)
    if command.terrain is None and command.level is None:
        return skill, skill.ground(command.layout)
    terrain = command.terrain or skill.ground(command.layout).family.name
    ground = ground_of(terrain, command.level, skill.levels, command.layout)
    if command.level is None and "=" not in terrain:
        ground = Ground(ground.family, skill.value(ground.family.name), command.layout)
    return skill, ground
