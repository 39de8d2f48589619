"""Slopes, up and down (paper, table of maximum difficulty: parameter `angle`)."""

import math
from functools import partial

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, beyond_x, inside_square
from arrive.terrain.shapes import (
    DARK,
    EARTH,
    GROUND_HALF,
    LIGHT,
    START,
    WHOLE,
    block,
    evaluation_span,
    ramp,
    square,
)
from arrive.terrain.tile import Tile

PLATFORM_HALF = 1.0
"""Half the width of the level ground in the centre of the training layout, for ANYmal C [m]."""


def build(angle_deg: float, rng: np.random.Generator, layout: Layout, size: float, direction: int) -> Tile:
    """Slabs at `angle_deg` [deg] that rise (+1) or fall (-1) from where the robot starts.

    In training, four slabs rise around a square platform, or two fall from a level ridge along y, because a pyramid
    that falls in four directions cannot be built from slabs. In evaluation, 4 m (horizontal) of slope lie ahead, then
    level ground. Every target is valid. Targets on the slope or beyond count for the curriculum.
    """
    angle = direction * math.radians(angle_deg)
    if layout == "evaluation":
        return _flank(angle, *evaluation_span(size))
    return (_bowl if direction > 0 else _roof)(angle, PLATFORM_HALF * size)


def _bowl(angle: float, half: float) -> Tile:
    slabs = [ramp(half, GROUND_HALF, angle, quarter * math.pi / 2) for quarter in range(4)]
    boxes = [square(half, 0.0), *slabs]
    return assemble(boxes, [START, EARTH, LIGHT, EARTH, LIGHT], crossing=~inside_square(half))


def _roof(angle: float, half: float) -> Tile:
    ridge = block((-half, half), WHOLE, 0.0)
    slabs = [ramp(half, GROUND_HALF, angle, yaw) for yaw in (0.0, math.pi)]
    beside = beyond_x(half) | ~beyond_x(-half)
    return assemble([ridge, *slabs], [START, EARTH, LIGHT], crossing=beside)


def _flank(angle: float, start: float, end: float) -> Tile:
    boxes = [
        block((-GROUND_HALF, start), WHOLE, 0.0),
        ramp(start, end, angle),
        block((end, GROUND_HALF), WHOLE, (end - start) * math.tan(angle)),
    ]
    return assemble(boxes, [START, EARTH, DARK], crossing=beyond_x(start))


SLOPE = Family("slope", "a slope up", "angle", "deg", 0.0, 55.0, partial(build, direction=1), random=False)
SLOPE_DOWN = Family("slope_down", "a slope down", "angle", "deg", 0.0, 55.0, partial(build, direction=-1), random=False)
