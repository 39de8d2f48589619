"""Walk around high obstacles (paper, section Terrains; table of maximum difficulty: parameter `length`)."""

from functools import reduce

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, cell_grid, dilate
from arrive.terrain.shapes import ACCENT, GROUND_HALF, LIGHT, block, square
from arrive.terrain.tile import RASTER_SIZE, Tile

HEIGHT = 1.2
"""Height of the pillars [m]: more than the robot can climb."""
PASSAGE = 1.0
"""Least free distance between two pillars [m]; a robot 0.6 m wide passes, so every target can be reached."""
CLEAR_RADIUS = 1.2
"""No pillar is nearer to the start than this [m]."""
STANDING_RADIUS = 0.5
"""Targets nearer to a pillar than this are invalid [m], so that a robot has room to stand there."""
MAX_PILLARS = 34
"""Pillars of a tile where that many find room."""
MAX_DARTS = 400
"""Places tried for a pillar; the widest ones find room for about half of `MAX_PILLARS`."""
TRAINING_HALF = 6.0
"""Pillars have their centres in the square of this half edge in training [m]."""
EVALUATION_X = (1.2, 4.4)
"""The pillars of the evaluation layout lie in this range of x [m], which leaves room around the start and target."""


def build(side: float, rng: np.random.Generator, layout: Layout) -> Tile:
    """Square pillars at random places with passages between; in evaluation the first one blocks the straight line.

    Targets are invalid on and near pillars; every other one counts as crossing.
    """
    if layout == "training":
        low, high = np.full(2, -TRAINING_HALF), np.full(2, TRAINING_HALF)
        first = []
    else:
        low = np.array([EVALUATION_X[0] + side / 2, -TRAINING_HALF])
        high = np.array([EVALUATION_X[1] - side / 2, TRAINING_HALF])
        first = [rng.uniform((max(low[0], 2.2), -0.1), (min(high[0], 3.4), 0.1))]
    centers = _throw_darts(first, low, high, side, rng)
    half = side / 2
    pillars = [block((x - half, x + half), (y - half, y + half), HEIGHT) for x, y in centers]
    palette = [LIGHT] + [ACCENT] * len(pillars)
    valid = ~dilate(_covered(centers, half), STANDING_RADIUS)
    return assemble([square(GROUND_HALF, 0.0), *pillars], palette, target_valid=valid)


def _throw_darts(
    first: list[np.ndarray], low: np.ndarray, high: np.ndarray, side: float, rng: np.random.Generator
) -> list[np.ndarray]:
    """Centres of pillars: `first`, then random places that keep clear of the start and of those before."""
    centers = list(first)
    for dart in rng.uniform(low, high, (MAX_DARTS, 2)):
        free = _distance(dart, side / 2) >= CLEAR_RADIUS
        if free and all(_distance(dart - other, side) >= PASSAGE for other in centers):
            centers.append(dart)
        if len(centers) == MAX_PILLARS:
            break
    return centers


def _distance(offset: np.ndarray, half: float) -> float:
    """Distance [m] from a point to a square of this half edge that is `offset` away.

    With the whole side as half edge it is the distance between two squares.
    """
    return float(np.linalg.norm(np.maximum(np.abs(offset) - half, 0.0)))


def _covered(centers: list[np.ndarray], half: float) -> np.ndarray:
    """Cells under a pillar."""
    x, y = cell_grid()
    squares = (np.maximum(np.abs(x - center[0]), np.abs(y - center[1])) <= half for center in centers)
    return reduce(np.logical_or, squares, np.zeros((RASTER_SIZE, RASTER_SIZE), dtype=bool))


OBSTACLES = Family("obstacles", "pillars to walk around", "side", "m", 0.2, 1.1, build, random=True)
