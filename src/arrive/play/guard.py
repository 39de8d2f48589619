"""What browsers may say: every message is read and checked before viser acts on it.

viser trusts its clients: it sets whatever property a message names, passes numbers on as they come, and opens a tunnel
to the internet on request. So only the messages that the page itself sends are let through, with finite values within
the range of what they set; all others are dropped.
"""

import math
import time
from asyncio import sleep
from collections.abc import Callable
from typing import Any

import viser
from viser import _messages
from websockets.asyncio.server import ServerConnection

from arrive.play.stick import parse_stick

LARGEST_MESSAGE = 16_384
"""[bytes]; a page's own messages have a few hundred."""
LONGEST_TEXT = 200
FARTHEST = 1e4
"""Largest coordinate [m]."""
LARGEST_SCREEN = 100_000
"""[px]."""
MESSAGES_PER_S = 400
"""A connection that sends more is heard no faster than this; a page sends up to about 100."""
PATIENCE = 100
"""A connection is closed after so many messages that are dropped."""
POLICY_VIOLATION = 1008
"""Close code (RFC 6455, section 7.4.1)."""
Message = _messages.Message


class Guard:
    """Says which messages are let through to a server."""

    def __init__(self) -> None:
        """Let nothing through until `server` is known."""
        self.server: viser.ViserServer | None = None
        self._checks: dict[type[Message], Callable[[Any], bool]] = {
            _messages.ViewerCameraMessage: _camera_is_sound,
            _messages.ScenePointerMessage: _click_is_sound,
            _messages.TransformControlsUpdateMessage: _drag_is_sound,
            _messages.TransformControlsDragStartMessage: lambda message: _are_texts(message.name, message.owner),
            _messages.TransformControlsDragEndMessage: lambda message: _are_texts(message.name, message.owner),
            _messages.CommandTriggerMessage: lambda message: _are_texts(message.uuid),
            _messages.GuiUpdateMessage: self._update_is_sound,
        }

    def admits(self, raw: bytes | str) -> bool:
        """Whether viser may see a message; nothing that it holds makes this raise."""
        if not isinstance(raw, bytes) or self.server is None:
            return False
        try:
            message = Message.deserialize(raw)
            check = self._checks.get(type(message))
            return check is not None and check(message)
        except Exception:  # whatever bytes make a decoder raise
            return False

    def _update_is_sound(self, message: _messages.GuiUpdateMessage) -> bool:
        """A value that its control offers, and nothing but the value."""
        if not (_are_texts(message.uuid) and isinstance(message.updates, dict) and set(message.updates) == {"value"}):
            return False
        # viser has no public way from a message to its control; without this one nothing is let through.
        control = self.server.gui._gui_input_handle_from_uuid.get(message.uuid)
        return control is not None and offers(control, message.updates["value"])


def offers(control: Any, value: object) -> bool:
    """Whether a person could have given a control this value."""
    if isinstance(control, viser.GuiButtonHandle | viser.GuiCheckboxHandle):
        return isinstance(value, bool)
    if isinstance(control, viser.GuiSliderHandle):
        return _is_number(value) and control.min - 1e-6 <= value <= control.max + 1e-6
    if isinstance(control, viser.GuiDropdownHandle):
        return value in control.options
    return isinstance(control, viser.GuiTextHandle) and isinstance(value, str) and parse_stick(value) is not None


def guarded(guard: Guard) -> type[ServerConnection]:
    """Connections that hear only what a guard admits, and no more of it than a server can work off."""

    class GuardedConnection(ServerConnection):
        _dropped, _second, _heard = 0, 0, 0

        async def recv(self, *args: Any, **kwargs: Any) -> Any:
            """The next message that is admitted."""
            while True:
                raw = await super().recv(*args, **kwargs)
                await self._keep_pace()
                if guard.admits(raw):
                    return raw
                self._dropped += 1
                if self._dropped > PATIENCE:
                    await self.close(POLICY_VIOLATION, "too many messages that mean nothing here")

        async def _keep_pace(self) -> None:
            now_s = time.monotonic()
            if int(now_s) != self._second:
                self._second, self._heard = int(now_s), 0
            self._heard += 1
            if self._heard > MESSAGES_PER_S:
                await sleep(1.0 - now_s % 1.0)

    return GuardedConnection


def _camera_is_sound(message: _messages.ViewerCameraMessage) -> bool:
    return (
        _are_numbers(message.wxyz, 4, 2.0)
        and all(_are_numbers(part, 3) for part in (message.position, message.look_at, message.up_direction))
        and all(_is_number(part) for part in (message.fov, message.near, message.far))
        and all(_is_number(size, LARGEST_SCREEN) and size >= 0 for size in (message.image_height, message.image_width))
    )


def _click_is_sound(message: _messages.ScenePointerMessage) -> bool:
    return (
        message.event_type == "click"
        and (message.modifier is None or _are_texts(message.modifier))
        and _are_numbers(message.ray_origin, 3)
        and _are_numbers(message.ray_direction, 3, 2.0)
        and math.hypot(*message.ray_direction) > 1e-6
        and len(message.screen_pos) == 1
        and _are_numbers(message.screen_pos[0], 2)
    )


def _drag_is_sound(message: _messages.TransformControlsUpdateMessage) -> bool:
    return (
        _are_texts(message.name, message.owner)
        and _are_numbers(message.position, 3)
        and _are_numbers(message.wxyz, 4, 2.0)
    )


def _are_texts(*values: object) -> bool:
    return all(isinstance(value, str) and len(value) <= LONGEST_TEXT for value in values)


def _are_numbers(values: object, count: int, largest: float = FARTHEST) -> bool:
    return isinstance(values, tuple) and len(values) == count and all(_is_number(value, largest) for value in values)


def _is_number(value: object, largest: float = FARTHEST) -> bool:
    """Whether a value is one finite number of at most this size."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= largest
