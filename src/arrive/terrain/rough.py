"""A rough surface (paper, section Terrains; not in its table of maximum difficulty)."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble
from arrive.terrain.shapes import EARTH, EVALUATION_END, EVALUATION_START, GROUND_HALF
from arrive.terrain.tile import HeightField, Tile

GRID = 0.2
"""Distance of the random heights [m] (legged_gym's `downsampled_scale`); triangles between them."""
LEVEL_RADIUS = 0.7
"""Vertices this near to the start are at height zero [m], which makes 0.4 m around it level."""
FULL_RADIUS = 1.1
"""From here on the surface is as rough as anywhere [m]."""


def build(amplitude: float, rng: np.random.Generator, layout: Layout) -> Tile:
    """Vertex heights uniform in [-amplitude, amplitude] [m]; every target is valid and counts as crossing."""
    vertices = np.linspace(-GROUND_HALF, GROUND_HALF, round(2 * GROUND_HALF / GRID) + 1)
    x, y = vertices[:, None], vertices[None, :]
    heights = rng.uniform(-amplitude, amplitude, (vertices.size, vertices.size))
    if layout == "training":
        heights *= np.clip((np.hypot(x, y) - LEVEL_RADIUS) / (FULL_RADIUS - LEVEL_RADIUS), 0.0, 1.0)
    else:
        heights *= (x > EVALUATION_START + GRID / 2) & (x < EVALUATION_END - GRID / 2)
    return assemble([], [EARTH], height_field=HeightField(heights, GROUND_HALF))


ROUGH = Family("rough", "a rough surface", "amplitude", "m", 0.0, 0.1, build, random=True)
