"""Blocks, frames and ramps from which the families build their ground, and its colours."""

import math

from arrive.terrain.tile import RASTER_HALF, Box

GROUND_HALF = RASTER_HALF + 1.0
"""Half the edge of the ground [m]: larger than the raster, so that the raster's outermost cells are not at an edge."""
THICKNESS = 1.0
"""Smallest thickness of the ground [m]. Feet that sink in by a few centimetres must not reach the far side."""
EVALUATION_START = 0.6
"""x at which the terrain of the evaluation layout begins for ANYmal C [m]: just ahead of the front feet of a 1.1 m long
robot."""
EVALUATION_LENGTH = 4.0
"""Length of the evaluation terrain (paper, section Maximum Terrain Difficulty) [m]."""

Colour = tuple[float, float, float]
START: Colour = (0.62, 0.67, 0.62)
LIGHT: Colour = (0.70, 0.69, 0.66)
DARK: Colour = (0.55, 0.56, 0.57)
SHADED: Colour = (0.64, 0.63, 0.61)
EARTH: Colour = (0.67, 0.61, 0.53)
ABYSS: Colour = (0.20, 0.21, 0.24)
ACCENT: Colour = (0.80, 0.48, 0.32)

WHOLE = (-GROUND_HALF, GROUND_HALF)
"""Interval that spans the ground along one axis [m]."""


def evaluation_span(size: float) -> tuple[float, float]:
    """x at which the terrain of the evaluation layout begins and ends for a robot of this size [m]."""
    return EVALUATION_START * size, EVALUATION_START * size + EVALUATION_LENGTH


def block(x: tuple[float, float], y: tuple[float, float], top: float) -> Box:
    """An axis-aligned block over x and y intervals [m], solid down to `THICKNESS` below its top and below zero."""
    bottom = min(top, 0.0) - THICKNESS
    return Box(
        center=((x[0] + x[1]) / 2, (y[0] + y[1]) / 2, (top + bottom) / 2),
        half_size=((x[1] - x[0]) / 2, (y[1] - y[0]) / 2, (top - bottom) / 2),
    )


def square(half: float, top: float) -> Box:
    """A square block around the origin [m]."""
    return block((-half, half), (-half, half), top)


def frame(inner: float, outer: float, top: float) -> list[Box]:
    """Four non-overlapping blocks between two squares around the origin with these half edges [m]."""
    sides = ((-outer, -inner), (inner, outer))
    across = [block(side, (-outer, outer), top) for side in sides]
    return across + [block((-inner, inner), side, top) for side in sides]


def ramp(start: float, end: float, angle: float, yaw: float = 0.0) -> Box:
    """A slab across the ground whose top rises along +x (turned by `yaw` [rad]) from height zero.

    Its top spans x from `start` to `end` [m] at `angle` [rad] to the horizontal; a negative angle falls.
    """
    rise = (end - start) * math.tan(angle)
    x = (start + end) / 2 + THICKNESS / 2 * math.sin(angle)
    z = rise / 2 - THICKNESS / 2 * math.cos(angle)
    pitch = -angle  # a positive rotation about y turns x downwards
    return Box(
        center=(x * math.cos(yaw), x * math.sin(yaw), z),
        half_size=((end - start) / math.cos(angle) / 2, GROUND_HALF, THICKNESS / 2),
        quat=(
            math.cos(yaw / 2) * math.cos(pitch / 2),
            -math.sin(yaw / 2) * math.sin(pitch / 2),
            math.cos(yaw / 2) * math.sin(pitch / 2),
            math.sin(yaw / 2) * math.cos(pitch / 2),
        ),
    )
