"""A rough surface (paper, section Terrains; not in its table of maximum difficulty)."""

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble
from arrive.terrain.shapes import EARTH, GROUND_HALF, evaluation_span
from arrive.terrain.tile import START_RADIUS, HeightField, Tile

GRID = 0.2
"""Distance between vertices with random heights [m] (legged_gym's `downsampled_scale`). Triangles connect them."""
LEVEL_MARGIN = 0.3
"""Vertices up to this far outside `START_RADIUS` have height zero [m], so that everything inside it is level."""
RAMP = 0.4
"""Distance over which the roughness then grows to its full amplitude [m]."""


def build(amplitude: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """Vertex heights uniform in [-amplitude, amplitude] [m]. All targets are valid and count for the curriculum."""
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
