"""Flat ground, the easiest terrain and the reference for gait and energy."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble
from arrive.terrain.shapes import GROUND_HALF, LIGHT, square
from arrive.terrain.tile import Tile


def build(value: float, rng: np.random.Generator, layout: Layout) -> Tile:
    """One slab; every target is valid and, since there is nothing to cross, counts as crossing."""
    return assemble([square(GROUND_HALF, 0.0)], palette=[LIGHT])


FLAT = Family("flat", "flat ground", "none", "", 0.0, 0.0, build, random=False)
