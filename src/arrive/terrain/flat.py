"""Flat ground, the easiest terrain and the reference for gait and energy."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble
from arrive.terrain.shapes import LIGHT, square
from arrive.terrain.tile import Tile

REACH = 250.0
"""Half the edge of the ground [m]: robots walk 100 m on it; beyond the raster its edge, of height zero, counts."""


def build(value: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """One slab; every target is valid and, since there is nothing to cross, counts as crossing."""
    return assemble([square(REACH, 0.0)], palette=[LIGHT])


FLAT = Family("flat", "flat ground", "none", "", 0.0, 0.0, build, random=False)
