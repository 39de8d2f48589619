"""What browsers may say: every message is read and checked before viser acts on it.

viser trusts its clients: it sets whatever property a message names, passes numbers on as they come, and opens a tunnel
to the internet on request. So only the messages that the page itself sends are let through, with finite values within
the range of what they set; all others are dropped.
"""

import math
import time
from asyncio import sleep
from collections.abc import Callable
from typing import Any, TypeGuard

import msgspec
import viser
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
Fields = dict[str, Any]
"""A message without its type."""


class Guard:
    """Says which messages are let through to a server."""

    def __init__(self) -> None:
        """Let nothing through until `server` is known."""
        self.server: viser.ViserServer | None = None
        self._checks: dict[str, Callable[[Fields], bool]] = {
            "ViewerCameraMessage": _camera_is_sound,
            "ScenePointerMessage": _click_is_sound,
            "TransformControlsUpdateMessage": _drag_is_sound,
            "TransformControlsDragStartMessage": _target_is_sound,
            "TransformControlsDragEndMessage": _target_is_sound,
            "CommandTriggerMessage": lambda fields: set(fields) == {"uuid"} and _is_text(fields["uuid"]),
            "GuiUpdateMessage": self._update_is_sound,
        }

    def admits(self, raw: bytes | str) -> bool:
        """Whether viser may see a message; nothing that it holds makes this raise."""
        if not isinstance(raw, bytes) or self.server is None:
            return False
        try:
            fields = msgspec.msgpack.decode(raw)
            return self._checks[fields.pop("type")](fields)
        except Exception:  # whatever bytes and structures make a decoder or a check raise
            return False

    def _update_is_sound(self, fields: Fields) -> bool:
        """A value that its control offers, and nothing but the value."""
        if set(fields) != {"uuid", "updates"} or set(fields["updates"]) != {"value"}:
            return False
        # viser has no public way from a message to its control; without this one nothing is let through.
        assert self.server is not None
        control = self.server.gui._gui_input_handle_from_uuid.get(fields["uuid"])
        return control is not None and offers(control, fields["updates"]["value"])


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
                    # Not closed politely: who does this need not answer, and would be waited for.
                    self.transport.abort()

        async def _keep_pace(self) -> None:
            now_s = time.monotonic()
            if int(now_s) != self._second:
                self._second, self._heard = int(now_s), 0
            self._heard += 1
            if self._heard > MESSAGES_PER_S:
                await sleep(1.0 - now_s % 1.0)

    return GuardedConnection


def _camera_is_sound(fields: Fields) -> bool:
    sizes = {"image_height", "image_width"}
    lengths = {"fov", "near", "far"}
    places = {"position", "look_at", "up_direction"}
    return (
        set(fields) == sizes | lengths | places | {"wxyz"}
        and _are_numbers(fields["wxyz"], 4, 2.0)
        and all(_are_numbers(fields[name], 3) for name in places)
        and all(_is_number(fields[name]) for name in lengths)
        and all(_is_number(fields[name], LARGEST_SCREEN) and fields[name] >= 0 for name in sizes)
    )


def _click_is_sound(fields: Fields) -> bool:
    return (
        set(fields) == {"event_type", "ray_origin", "ray_direction", "screen_pos", "modifier"}
        and fields["event_type"] == "click"
        and (fields["modifier"] is None or _is_text(fields["modifier"]))
        and _are_numbers(fields["ray_origin"], 3)
        and _are_numbers(fields["ray_direction"], 3, 2.0)
        and math.hypot(*fields["ray_direction"]) > 1e-6
        and len(fields["screen_pos"]) == 1
        and _are_numbers(fields["screen_pos"][0], 2)
    )


def _drag_is_sound(fields: Fields) -> bool:
    pose = {"position": 3, "wxyz": 4}
    return all(_are_numbers(fields.pop(name), size) for name, size in pose.items()) and _target_is_sound(fields)


def _target_is_sound(fields: Fields) -> bool:
    return set(fields) in ({"name"}, {"name", "owner"}) and all(map(_is_text, fields.values()))


def _is_text(value: object) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST_TEXT


def _are_numbers(values: object, count: int, largest: float = FARTHEST) -> bool:
    return isinstance(values, list) and len(values) == count and all(_is_number(value, largest) for value in values)


def _is_number(value: object, largest: float = FARTHEST) -> TypeGuard[float]:
    """Whether a value is one finite number of at most this size."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= largest
