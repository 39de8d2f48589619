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
"""Places tried for a pillar; the widest ones find room for about a third of `MAX_PILLARS`."""
ROBOT_HALF_WIDTH = 0.3
"""A robot on a straight way touches the pillars that are nearer to it than this [m]."""
SHADOW_ANGLES = 720
"""Directions from the start in which pillars are looked for: at most 5 cm apart within the targets' distance."""
TRAINING_HALF = 4.5
"""Pillars have their centres in the square of this half edge in training [m], small enough that `MAX_PILLARS` narrow
ones stand nearly as close together as in evaluation."""
EVALUATION_X = (1.2, 4.4)
"""The pillars of the evaluation layout lie in this range of x [m], which leaves room around the start and target."""
EVALUATION_HALF_Y = 6.0
"""Their centres lie within this of the straight line [m]: too far for a way around all of them."""


def build(side: float, rng: np.random.Generator, layout: Layout) -> Tile:
    """Square pillars at random places with passages between; in evaluation the first one blocks the straight line.

    Targets are invalid on and near pillars. Those to which no straight way leads from the start count as crossing: who
    walks to another one has walked around nothing.
    """
    if layout == "training":
        low, high = np.full(2, -TRAINING_HALF), np.full(2, TRAINING_HALF)
        first = []
    else:
        low = np.array([EVALUATION_X[0] + side / 2, -EVALUATION_HALF_Y])
        high = np.array([EVALUATION_X[1] - side / 2, EVALUATION_HALF_Y])
        first = [rng.uniform((max(low[0], 2.2), -0.1), (min(high[0], 3.4), 0.1))]
    centers = _throw_darts(first, low, high, side, rng)
    half = side / 2
    pillars = [block((x - half, x + half), (y - half, y + half), HEIGHT) for x, y in centers]
    palette = [LIGHT] + [ACCENT] * len(pillars)
    valid = ~dilate(_covered(centers, half), STANDING_RADIUS)
    hidden = _hidden(np.array(centers), half + ROBOT_HALF_WIDTH)
    return assemble([square(GROUND_HALF, 0.0), *pillars], palette, valid, hidden, parted=False)


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


def _hidden(centers: np.ndarray, half: float) -> np.ndarray:
    """Cells that the straight way from the origin reaches only through a square of this half edge."""
    angles = np.linspace(-np.pi, np.pi, SHADOW_ANGLES, endpoint=False)
    direction = np.stack([np.cos(angles), np.sin(angles)], axis=-1)[:, None]
    direction = np.where(np.abs(direction) < 1e-9, 1e-9, direction)
    sides = np.stack([(centers - half) / direction, (centers + half) / direction])
    entry, leave = sides.min(0).max(-1), sides.max(0).min(-1)
    first = np.where((entry < leave) & (leave > 0.0), entry, np.inf).min(-1)
    x, y = cell_grid()
    nearest = np.round((np.arctan2(y, x) + np.pi) / (2 * np.pi) * SHADOW_ANGLES).astype(int) % SHADOW_ANGLES
    return np.hypot(x, y) > first[nearest]


OBSTACLES = Family("obstacles", "pillars to walk around", "side", "m", 0.2, 1.1, build, random=True)
