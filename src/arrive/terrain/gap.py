"""Step or leap over a gap (paper, section Terrains)."""

from itertools import pairwise

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, beyond_x, dilate, inside_square
from arrive.terrain.shapes import ABYSS, GROUND_HALF, LIGHT, START, WHOLE, block, frame, square
from arrive.terrain.tile import Tile

# Lengths that give the robot room are for ANYmal C and scale with the robot's size.
PLATFORM_HALF = 1.2
"""Half the edge of the platform that the first ring gap surrounds in training [m]."""
PLATEAU = 1.3
"""Width of the ground between ring gaps [m]: a 1.1 m long robot can stand on it."""
LAST_EDGE = 3.8
"""Largest outer edge of any further ring [m], so that most targets lie beyond all rings."""
EVALUATION_GAP_X = 1.5
"""x of the gap's near edge in the evaluation layout [m]."""
DEPTH = 2.0
"""Depth of a gap [m]: too deep to step into."""
NARROWEST = 0.02
"""Width of the first training level's gap [m]."""
SHALLOWEST, DEPTH_PER_WIDTH = 0.03, 4.0
"""Depth of the first training level's gap [m], and increase in depth per metre of width, up to `DEPTH`. A gap of 0.12 m
is 0.43 m deep, which already looks bottomless with the clipped heights of `robust`. Robots learn nothing from falling
into a deep gap, but a foot that sinks into a groove gives them a signal."""
FALL_HEIGHT = -0.5
"""A base below this height cannot climb out [m]."""
EDGE_MARGIN = 0.35
"""Targets closer to a gap than this are invalid [m]: a robot standing there would have feet over the hole."""


def build(width: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """Ring gaps around the platform (training), or one straight gap ahead (evaluation).

    Targets beyond the first gap count for the curriculum. A second ring is added where it fits: crossing takes only
    half a second of an episode, so this doubles what training sees of it. Narrow training gaps are also shallow.
    """
    depth = min(DEPTH, SHALLOWEST + DEPTH_PER_WIDTH * (width - NARROWEST)) if layout == "training" else DEPTH
    bottom = square(GROUND_HALF, -depth)
    if layout == "training":
        platform = PLATFORM_HALF * size
        rings = list(pairwise([*_ring_edges(width, platform, PLATEAU * size), GROUND_HALF]))
        gaps, grounds = rings[::2], rings[1::2]
        boxes = [bottom, square(platform, 0.0), *(box for ring in grounds for box in frame(*ring, 0.0))]
        hole = np.any([inside_square(far) & ~inside_square(near) for near, far in gaps], axis=0)
        beyond = ~inside_square(gaps[0][1]) & ~hole
    else:
        near_edge = EVALUATION_GAP_X * size
        far_edge = near_edge + width
        near_side, far_side = (-GROUND_HALF, near_edge), (far_edge, GROUND_HALF)
        boxes = [bottom, block(near_side, WHOLE, 0.0), block(far_side, WHOLE, 0.0)]
        beyond = beyond_x(far_edge)
        hole = beyond_x(near_edge) & ~beyond
    palette = [ABYSS, START] + [LIGHT] * (len(boxes) - 2)
    valid = ~dilate(hole, EDGE_MARGIN * size)
    return assemble(boxes, palette, valid, beyond, fall_height=FALL_HEIGHT * size)


def _ring_edges(width: float, platform: float, plateau: float) -> list[float]:
    """Distances from the centre to the near and far edges of the training layout's gaps, nearest first [m]."""
    edges = [platform, platform + width]
    while (near := edges[-1] + plateau) + width <= LAST_EDGE:
        edges += [near, near + width]
    return edges


GAP = Family("gap", "a gap to leap over", "width", "m", NARROWEST, 1.4, build, random=False)
