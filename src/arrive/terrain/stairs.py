"""Stairs, up and down (paper, table of maximum difficulty: parameter `rise`)."""

from functools import partial
from itertools import pairwise

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, beyond_x, inside_square
from arrive.terrain.shapes import GROUND_HALF, LIGHT, SHADED, START, WHOLE, block, evaluation_span, frame, square
from arrive.terrain.tile import Box, Tile

TREAD = 0.31
"""Depth of a step [m] (legged_gym's pyramid stairs)."""
PLATFORM_HALF = 1.0
"""Half the edge of the square platform in the centre of the training layout, for ANYmal C [m]."""
TRAINING_STEPS = 12
"""Number of steps around the platform. The last one, the landing, begins at 4.41 m for ANYmal C, so that some of the
far targets lie on it."""
EVALUATION_STEPS = 13
"""Number of steps in the evaluation layout: 13 treads are 4.03 m."""


def build(rise: float, rng: np.random.Generator, layout: Layout, size: float, direction: int) -> Tile:
    """Square rings of steps outwards (training) or a flight along +x (evaluation), up (+1) or down (-1).

    Every target is valid. Targets on a step count for the curriculum.
    """
    if layout == "training":
        half = PLATFORM_HALF * size
        rings = _rings(rise, direction, half)
        on_steps = ~inside_square(half)
    else:
        start, _ = evaluation_span(size)
        rings = _flight(direction * rise, start)
        on_steps = beyond_x(start)
    boxes = [box for ring in rings for box in ring]
    palette = [_colour(k) for k, ring in enumerate(rings) for _ in ring]
    return assemble(boxes, palette, crossing=on_steps)


def _rings(rise: float, direction: int, half: float) -> list[list[Box]]:
    """The platform and its rings of steps: frames if they rise, nested squares if they fall."""
    edges = [half + k * TREAD for k in range(TRAINING_STEPS)] + [GROUND_HALF]
    if direction < 0:
        return [[square(edge, -k * rise)] for k, edge in enumerate(edges)]
    steps = [frame(inner, outer, (k + 1) * rise) for k, (inner, outer) in enumerate(pairwise(edges))]
    return [[square(half, 0.0)], *steps]


def _flight(height_per_step: float, start: float) -> list[list[Box]]:
    """The ground before the flight, and the steps. The last one is the landing."""
    edges = [start + k * TREAD for k in range(EVALUATION_STEPS)]
    intervals = pairwise([-GROUND_HALF, *edges, GROUND_HALF])
    return [[block(interval, WHOLE, k * height_per_step)] for k, interval in enumerate(intervals)]


def _colour(step: int) -> tuple[float, float, float]:
    if step == 0:
        return START
    return SHADED if step % 2 else LIGHT


STAIRS = Family("stairs", "stairs up", "rise", "m", 0.01, 0.45, partial(build, direction=1), random=False)
STAIRS_DOWN = Family("stairs_down", "stairs down", "rise", "m", 0.01, 0.45, partial(build, direction=-1), random=False)
