"""Slopes, up and down (paper, table of maximum difficulty: parameter `angle`)."""

import math
from functools import partial

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, beyond_x, inside_square
from arrive.terrain.shapes import (
    DARK,
    EARTH,
    EVALUATION_END,
    EVALUATION_START,
    GROUND_HALF,
    LIGHT,
    START,
    WHOLE,
    block,
    ramp,
    square,
)
from arrive.terrain.tile import Tile

PLATFORM_HALF = 1.0
"""Half the width of the level ground in the middle in training [m]."""


def build(angle_deg: float, rng: np.random.Generator, layout: Layout, direction: int) -> Tile:
    """Slabs at `angle_deg` [deg] that rise (+1) or fall (-1) from where the robot starts.

    In training four slabs rise around a square platform, or two fall from a level ridge along y: a pyramid that
    falls in four directions is no union of slabs. In evaluation 4 m (horizontal) of slope lie ahead, then level
    ground. Every target is valid; crossing means being on the slope or beyond.
    """
    angle = direction * math.radians(angle_deg)
    if layout == "evaluation":
        return _flank(angle)
    return _bowl(angle) if direction > 0 else _roof(angle)


def _bowl(angle: float) -> Tile:
    slabs = [ramp(PLATFORM_HALF, GROUND_HALF, angle, quarter * math.pi / 2) for quarter in range(4)]
    boxes = [square(PLATFORM_HALF, 0.0), *slabs]
    return assemble(boxes, [START, EARTH, LIGHT, EARTH, LIGHT], crossing=~inside_square(PLATFORM_HALF))


def _roof(angle: float) -> Tile:
    ridge = block((-PLATFORM_HALF, PLATFORM_HALF), WHOLE, 0.0)
    slabs = [ramp(PLATFORM_HALF, GROUND_HALF, angle, yaw) for yaw in (0.0, math.pi)]
    beside = beyond_x(PLATFORM_HALF) | ~beyond_x(-PLATFORM_HALF)
    return assemble([ridge, *slabs], [START, EARTH, LIGHT], crossing=beside)


def _flank(angle: float) -> Tile:
    boxes = [
        block((-GROUND_HALF, EVALUATION_START), WHOLE, 0.0),
        ramp(EVALUATION_START, EVALUATION_END, angle),
        block((EVALUATION_END, GROUND_HALF), WHOLE, (EVALUATION_END - EVALUATION_START) * math.tan(angle)),
    ]
    return assemble(boxes, [START, EARTH, DARK], crossing=beyond_x(EVALUATION_START))


SLOPE = Family("slope", "a slope up", "angle", "deg", 0.0, 55.0, partial(build, direction=1), random=False)
SLOPE_DOWN = Family("slope_down", "a slope down", "angle", "deg", 0.0, 55.0, partial(build, direction=-1), random=False)
