"""Climb out of a pit too deep to step out of (paper, section Terrains)."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, beyond_x, dilate, inside_square
from arrive.terrain.shapes import EARTH, GROUND_HALF, START, WHOLE, block, frame, square
from arrive.terrain.tile import Tile

# Lengths are for ANYmal C and scale with the robot's size.
FLOOR_HALF = 1.5
"""Half the edge of the square floor in training [m]: a 1.1 m long robot can turn on it."""
EVALUATION_WALL_X = 2.0
"""x of the wall in the evaluation layout [m], across the whole width."""
EDGE_MARGIN = 0.35
"""Targets closer to the wall than this, above or below it, are invalid [m]: the robot cannot stand astride it."""


def build(depth: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """A floor with higher ground around it (training) or ahead (evaluation); targets there count for the curriculum."""
    if layout == "training":
        half = FLOOR_HALF * size
        boxes = [square(half, 0.0), *frame(half, GROUND_HALF, depth)]
        outside = ~inside_square(half)
    else:
        wall = EVALUATION_WALL_X * size
        floor, ground = (-GROUND_HALF, wall), (wall, GROUND_HALF)
        boxes = [block(floor, WHOLE, 0.0), block(ground, WHOLE, depth)]
        outside = beyond_x(wall)
    near_wall = dilate(outside, EDGE_MARGIN * size) & dilate(~outside, EDGE_MARGIN * size)
    palette = [START] + [EARTH] * (len(boxes) - 1)
    return assemble(boxes, palette, target_valid=~near_wall, crossing=outside)


PIT = Family("pit", "a pit to climb out of", "depth", "m", 0.02, 1.1, build, random=False)
