"""Flat ground, the easiest terrain and the reference for gait and energy."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble
from arrive.terrain.shapes import LIGHT, square
from arrive.terrain.tile import Tile

REACH = 250.0
"""Half the edge of the ground [m]. Robots walk 100 m on it. Outside the raster, heights are zero like its edge."""


def build(value: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """One slab. Every target is valid and, since there is nothing to cross, counts for the curriculum."""
    return assemble([square(REACH, 0.0)], palette=[LIGHT])


FLAT = Family("flat", "flat ground", "none", "", 0.0, 0.0, build, random=False)
