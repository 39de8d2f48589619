"""Loads the newest network of a run that is still training."""

import threading
from collections.abc import Callable
from pathlib import Path

from arrive.errors import ArriveError
from arrive.play.playground import Playground
from arrive.play.skills import open_skill
from arrive.policies import POLICY_NAME, find_policy

PERIOD_S = 2.0
"""Time between two checks of the file [s]."""


class Follower:
    """Watches the policy file of a run in its own thread, and passes each new network to the simulation."""

    def __init__(self, name: str, post: Callable[[Callable[[Playground], None]], None]):
        """Find the policy file.

        Args:
            post: queues a function that the simulation calls between two control steps.

        Raises:
            ArriveError: there is no such run.
        """
        path = find_policy(name)
        self._name, self._post = name, post
        self._file = path / POLICY_NAME if path.is_dir() else path
        self._seen = self._stamp()

    def run(self, stop: threading.Event) -> None:
        """Watch the file until `stop` is set."""
        while not stop.wait(PERIOD_S):
            self.look()

    def look(self) -> None:
        """Load the policy if its file has been replaced since the last check."""
        stamp = self._stamp()
        if stamp in (self._seen, None):
            return
        self._seen = stamp
        try:
            skill = open_skill(self._name)
        except ArriveError as error:
            message = str(error)
            self._post(lambda playground: playground.messages.append(message))
        else:
            self._post(lambda playground: playground.learn(skill) if playground.skill.name == skill.name else None)

    def _stamp(self) -> tuple[int, int] | None:
        """Modification time and inode, which change when the file is replaced; None if there is no file."""
        try:
            status = Path(self._file).stat()
        except OSError:
            return None
        return status.st_mtime_ns, status.st_ino
