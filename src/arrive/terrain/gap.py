"""Step or leap over a gap (paper, section Terrains)."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, beyond_x, dilate, inside_square
from arrive.terrain.shapes import ABYSS, GROUND_HALF, LIGHT, START, WHOLE, block, frame, square
from arrive.terrain.tile import Tile

PLATFORM_HALF = 1.2
"""Half the edge of the platform that the ring gap surrounds in training [m]."""
EVALUATION_GAP_X = 1.5
"""x of the gap's near edge in the evaluation layout [m]."""
BOTTOM = -2.0
"""Height of the gap's bottom [m]."""
FALL_HEIGHT = -0.5
"""A base this far below the edges cannot come back [m]."""
RIM_HEIGHT = 0.0
"""The middle of a foot this low is below the edges [m]."""
EDGE_MARGIN = 0.35
"""Targets nearer to the gap than this are invalid [m]: a robot standing there would have feet over the hole."""


def build(width: float, rng: np.random.Generator, layout: Layout) -> Tile:
    """A gap around the platform (training) or across the way (evaluation); crossing means being beyond it."""
    bottom = square(GROUND_HALF, BOTTOM)
    if layout == "training":
        far_edge = PLATFORM_HALF + width
        boxes = [bottom, square(PLATFORM_HALF, 0.0), *frame(far_edge, GROUND_HALF, 0.0)]
        near, beyond = inside_square(PLATFORM_HALF), ~inside_square(far_edge)
    else:
        far_edge = EVALUATION_GAP_X + width
        near_side, far_side = (-GROUND_HALF, EVALUATION_GAP_X), (far_edge, GROUND_HALF)
        boxes = [bottom, block(near_side, WHOLE, 0.0), block(far_side, WHOLE, 0.0)]
        near, beyond = ~beyond_x(EVALUATION_GAP_X), beyond_x(far_edge)
    hole = ~near & ~beyond
    palette = [ABYSS, START] + [LIGHT] * (len(boxes) - 2)
    valid = ~dilate(hole, EDGE_MARGIN)
    return assemble(boxes, palette, valid, beyond, fall_height=FALL_HEIGHT, rim_height=RIM_HEIGHT)


GAP = Family("gap", "a gap to leap over", "width", "m", 0.1, 1.4, build, random=False)
