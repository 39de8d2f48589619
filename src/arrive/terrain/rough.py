"""A rough surface (paper, section Terrains; not in its table of maximum difficulty)."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble
from arrive.terrain.shapes import EARTH, GROUND_HALF, evaluation_span
from arrive.terrain.tile import START_RADIUS, HeightField, Tile

GRID = 0.2
"""Distance of the random heights [m] (legged_gym's `downsampled_scale`); triangles between them."""
LEVEL_MARGIN = 0.3
"""Vertices this far beyond `START_RADIUS` are still at height zero [m], so that all within that radius is level."""
RAMP = 0.4
"""After so much more the surface is as rough as anywhere [m]."""


def build(amplitude: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """Vertex heights uniform in [-amplitude, amplitude] [m]; every target is valid and counts as crossing."""
    vertices = np.linspace(-GROUND_HALF, GROUND_HALF, round(2 * GROUND_HALF / GRID) + 1)
    x, y = vertices[:, None], vertices[None, :]
    heights = rng.uniform(-amplitude, amplitude, (vertices.size, vertices.size))
    if layout == "training":
        level = START_RADIUS * size + LEVEL_MARGIN
        full = level + RAMP
        heights *= np.clip((np.hypot(x, y) - level) / (full - level), 0.0, 1.0)
    else:
        start, end = evaluation_span(size)
        heights *= (x > start + GRID / 2) & (x < end - GRID / 2)
    return assemble([], [EARTH], height_field=HeightField(heights, GROUND_HALF))


ROUGH = Family("rough", "a rough surface", "amplitude", "m", 0.0, 0.1, build, random=True)
