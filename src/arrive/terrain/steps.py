"""Random rectangular steps (paper, table of maximum difficulty: random steps, parameter +-height)."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble
from arrive.terrain.shapes import (
    ACCENT,
    DARK,
    GROUND_HALF,
    LIGHT,
    START,
    WHOLE,
    block,
    evaluation_span,
    frame,
    square,
)
from arrive.terrain.tile import Tile

Rectangle = tuple[float, float, float, float]
"""x from, x to, y from, y to [m]."""

PLATFORM_HALF = 0.8
"""Half the edge of the level square in the centre of the training layout, for ANYmal C [m]."""
TRAINING_HALF = 5.6
"""Half the edge of the square that is divided into steps in training [m]. Level ground lies outside."""
TRAINING_STEPS = 58
"""Steps around the platform: 2.1 m^2 each on average, like legged_gym's rectangles of 1 to 2 m by 1 to 2 m."""
EVALUATION_STEPS = 31
"""Steps in the evaluation layout, with the same average size."""
CUT = (0.35, 0.65)
"""Range of the fraction of its longer side at which a rectangle is cut."""


def build(height: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """Rectangles at heights drawn from {-h, -h/2, 0, h/2, h}, so that neighbours differ by up to 2 h.

    These are legged_gym's heights. Zero is added because here the steps leave no ground between them. All targets are
    valid and count for the curriculum.
    """
    if layout == "training":
        half = PLATFORM_HALF * size
        fixed = [square(half, 0.0), *frame(TRAINING_HALF, GROUND_HALF, 0.0)]
        steps = partition(_pinwheel(rng, half), TRAINING_STEPS, rng)
    else:
        start, end = evaluation_span(size)
        fixed = [block((-GROUND_HALF, start), WHOLE, 0.0), block((end, GROUND_HALF), WHOLE, 0.0)]
        steps = partition([(start, end, *WHOLE)], EVALUATION_STEPS, rng)
    multiples = rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], size=len(steps))
    boxes = [block(step[:2], step[2:], m * height) for step, m in zip(steps, multiples, strict=True)]
    palette = [START] * len(fixed) + [_colour(m) for m in multiples]
    return assemble([*fixed, *boxes], palette)


def _pinwheel(rng: np.random.Generator, half: float) -> list[Rectangle]:
    """Four equal rectangles around the platform, arranged clockwise or counter-clockwise at random."""
    p, q = half, TRAINING_HALF
    east, north, west, south = (p, q, -p, q), (-q, p, p, q), (-q, -p, -q, p), (-p, q, -q, -p)
    wheel = [east, north, west, south]
    return wheel if rng.random() < 0.5 else [(y0, y1, x0, x1) for x0, x1, y0, y1 in wheel]


def partition(rectangles: list[Rectangle], count: int, rng: np.random.Generator) -> list[Rectangle]:
    """Cut the largest rectangle in two until there are `count` rectangles."""
    rectangles = list(rectangles)
    while len(rectangles) < count:
        largest = max(range(len(rectangles)), key=lambda k: _area(rectangles[k]))
        x0, x1, y0, y1 = rectangles.pop(largest)
        fraction = rng.uniform(*CUT)
        if x1 - x0 > y1 - y0:
            cut = x0 + fraction * (x1 - x0)
            rectangles += [(x0, cut, y0, y1), (cut, x1, y0, y1)]
        else:
            cut = y0 + fraction * (y1 - y0)
            rectangles += [(x0, x1, y0, cut), (x0, x1, cut, y1)]
    return rectangles


def _area(rectangle: Rectangle) -> float:
    x0, x1, y0, y1 = rectangle
    return (x1 - x0) * (y1 - y0)


def _colour(multiple: float) -> tuple[float, float, float]:
    if multiple == 0.0:
        return LIGHT
    return ACCENT if multiple > 0 else DARK


STEPS = Family("steps", "random rectangular steps", "height", "m", 0.005, 0.25, build, random=True)
