"""A gamepad on this machine, through SDL (pygame); no window is opened."""

import math
import os
from types import ModuleType

from arrive.deployment import Joystick
from arrive.errors import ArriveError

TURN_RAD_S = 1.5
"""Largest rate at which the right stick turns the operator's heading [rad/s]."""
FULL = 32767.0
"""SDL's value for a stick at its end."""


class Gamepad:
    """Left stick: direction and speed. Right stick: turns the forward direction. A (south): forward = robot's heading.

    A policy may prefer one walking direction and turn into it. The forward direction is therefore a heading in the
    world that only the operator turns. It starts as the robot's heading.
    """

    def __init__(self) -> None:
        """Open the first gamepad whose layout SDL knows.

        Raises:
            ArriveError: pygame is missing, or there is no such gamepad; the message lists what was found.
        """
        self._pygame = pygame = _pygame()
        from pygame._sdl2 import controller

        pygame.display.init()
        pygame.joystick.init()
        controller.init()
        found = range(pygame.joystick.get_count())
        known = [i for i in found if controller.is_controller(i)]
        if not known:
            names = ", ".join(pygame.joystick.Joystick(i).get_name() for i in found)
            self.close()
            raise ArriveError(
                f"no gamepad: {f'SDL knows no layout for {names}' if names else 'no game controller was found'}. "
                "Connect one, or drive with --script FILE.csv"
            )
        self._pad = controller.Controller(known[0])
        self.name = self._pad.name
        self._heading: float | None = None
        self._last_s = 0.0

    def stick(self, time_s: float, yaw: float) -> Joystick:
        """The operator's current command.

        Args:
            time_s: time on any clock that never goes back [s].
            yaw: the robot's heading [rad].

        Raises:
            ArriveError: the gamepad was disconnected.
        """
        pygame, pad = self._pygame, self._pad
        pygame.event.pump()
        if not pad.attached():
            raise ArriveError(f"the gamepad {self.name} was disconnected")
        if self._heading is None or pad.get_button(pygame.CONTROLLER_BUTTON_A):
            self._heading = yaw
        turn = self._axis(pygame.CONTROLLER_AXIS_RIGHTX)
        self._heading -= TURN_RAD_S * turn * max(time_s - self._last_s, 0.0)
        self._heading = math.remainder(self._heading, 2.0 * math.pi)
        self._last_s = time_s
        # SDL's axes grow to the right and downwards.
        forward, left = -self._axis(pygame.CONTROLLER_AXIS_LEFTY), -self._axis(pygame.CONTROLLER_AXIS_LEFTX)
        return Joystick(forward, left, self._heading)

    def close(self) -> None:
        """Release the device."""
        self._pygame.quit()

    def _axis(self, axis: int) -> float:
        """Position of an axis, -1 to 1. Small offsets of the right stick at rest are ignored."""
        value = max(-1.0, self._pad.get_axis(axis) / FULL)
        at_rest = axis == self._pygame.CONTROLLER_AXIS_RIGHTX and abs(value) < 0.1
        return 0.0 if at_rest else value


def _pygame() -> ModuleType:
    """pygame, set up to read devices without a screen and without the focus of a window."""
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise ArriveError("a gamepad needs pygame: pip install pygame. Or drive with --script FILE.csv") from error
    return pygame
