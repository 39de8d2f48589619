"""Checks every message of a browser before viser handles it.

viser trusts its clients: a message can set any property to any value, or open a tunnel to the internet. So only the
messages that this page sends are passed on, with finite values within the range of their control. All others are
dropped.
"""

import math
from collections.abc import Callable
from typing import Any, TypeGuard

import msgspec
import viser

from arrive.play.stick import parse_stick

LARGEST_MESSAGE = 16_384
"""Largest message [bytes]. The page's own messages have a few hundred bytes."""
LONGEST_TEXT = 200
FARTHEST = 1e4
"""Largest coordinate [m]."""
LARGEST_SCREEN = 100_000
"""Largest width or height of a browser's window [px]."""
CAMERA = "ViewerCameraMessage"
"""Type of the first message of a page."""
Fields = dict[str, Any]
"""The fields of a message, without its type."""


class Guard:
    """Decides which messages viser receives."""

    def __init__(self) -> None:
        """Until `server` is set, no control can be changed."""
        self.server: viser.ViserServer | None = None
        self._checks: dict[str, Callable[[Fields], bool]] = {
            CAMERA: _camera_is_sound,
            "ScenePointerMessage": _click_is_sound,
            "TransformControlsUpdateMessage": _drag_is_sound,
            "TransformControlsDragStartMessage": _target_is_sound,
            "TransformControlsDragEndMessage": _target_is_sound,
            "CommandTriggerMessage": lambda fields: set(fields) == {"uuid"} and _is_text(fields["uuid"]),
            "GuiUpdateMessage": self._update_is_sound,
        }

    def admitted(self, raw: bytes | str) -> str:
        """Type of a message that viser may receive; empty if it may not. This never raises, whatever the message is."""
        if not isinstance(raw, bytes):
            return ""
        try:
            fields = msgspec.msgpack.decode(raw)
            kind = str(fields.pop("type"))
            return kind if self._checks[kind](fields) else ""
        except Exception:  # any fault in the bytes or the structure
            return ""

    def _update_is_sound(self, fields: Fields) -> bool:
        """The message sets only a value, which its control offers."""
        if set(fields) != {"uuid", "updates"} or set(fields["updates"]) != {"value"}:
            return False
        if self.server is None:
            return False
        # viser has no public way from a message to its control. If this one fails, the message is dropped.
        control = self.server.gui._gui_input_handle_from_uuid.get(fields["uuid"])
        return control is not None and offers(control, fields["updates"]["value"])


def offers(control: Any, value: object) -> bool:
    """Whether the control can be set to this value on the page."""
    if isinstance(control, viser.GuiButtonHandle | viser.GuiCheckboxHandle):
        return isinstance(value, bool)
    if isinstance(control, viser.GuiSliderHandle):
        return _is_number(value) and control.min - 1e-6 <= value <= control.max + 1e-6
    if isinstance(control, viser.GuiDropdownHandle):
        return value in control.options
    return isinstance(control, viser.GuiTextHandle) and isinstance(value, str) and parse_stick(value) is not None


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
    """Whether a value is a finite number of at most this size."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= largest
