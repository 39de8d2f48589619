"""Step or leap over a gap (paper, section Terrains)."""

from itertools import pairwise

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, beyond_x, dilate, inside_square
from arrive.terrain.shapes import ABYSS, GROUND_HALF, LIGHT, START, WHOLE, block, frame, square
from arrive.terrain.tile import Tile

# Lengths that must have room for the robot are those for ANYmal C.
PLATFORM_HALF = 1.2
"""Half the edge of the platform that the first ring gap surrounds in training [m]."""
PLATEAU = 1.3
"""Ground between ring gaps [m]: a 1.1 m long robot can stand on it."""
LAST_EDGE = 3.8
"""Further rings end here at the latest [m], so that most targets lie beyond all of them."""
EVALUATION_GAP_X = 1.5
"""x of the gap's near edge in the evaluation layout [m]."""
DEPTH = 2.0
"""Depth of a gap [m]: nothing can be stepped into."""
NARROWEST = 0.02
"""Width of the first training level's gap [m]."""
SHALLOWEST, DEPTH_PER_WIDTH = 0.03, 4.0
"""Depth of that gap [m], and how much deeper training's gaps are per metre that they are wider, up to `DEPTH`: one of
0.12 m is 0.43 m deep, deeper than any policy can tell. Robots learn nothing from falling into a deep one; a foot that
sinks into a groove tells them."""
FALL_HEIGHT = -0.5
"""A base this far below the edges cannot come back [m]."""
EDGE_MARGIN = 0.35
"""Targets nearer to a gap than this are invalid [m]: a robot standing there would have feet over the hole."""


def build(width: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """Gaps around the platform (training) or one across the way (evaluation); crossing means being beyond the first.

    Crossing takes half a second of an episode: where a second ring fits, training sees twice as much of it. Training's
    narrow gaps are shallow too.
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
    """Distances of the near and far edges of the training layout's gaps from its middle, nearest first [m]."""
    edges = [platform, platform + width]
    while (near := edges[-1] + plateau) + width <= LAST_EDGE:
        edges += [near, near + width]
    return edges


GAP = Family("gap", "a gap to leap over", "width", "m", NARROWEST, 1.4, build, random=False)
