"""Walk around high obstacles (paper, section Terrains; table of maximum difficulty: parameter `length`)."""

from functools import reduce

import numpy as np

from arrive.terrain.family import Family, Layout
from arrive.terrain.rasterise import assemble, cell_grid, dilate
from arrive.terrain.shapes import ACCENT, GROUND_HALF, LIGHT, block, square
from arrive.terrain.tile import RASTER_SIZE, Tile

HEIGHT = 1.2
"""Height of the pillars [m]: more than the robot can climb."""
NARROWEST, WIDEST = 0.2, 1.1
"""Sides of the pillars [m]."""
LOWEST_HEIGHT, FULL_HEIGHT_FROM = 0.02, 0.22
"""Height of the pillars on the first training level [m], and the side of the widest pillars from which all are `HEIGHT`
tall [m]. Robots walk over the first level's. Where heights in between grew with the level, robots learnt to climb
pillars and had to unlearn it."""
FEWEST, MOST_FROM = 20, 0.5
"""Number of pillars on the first training level, and the side of the widest pillars from which there are as many as fit
[m]."""
# Lengths that give the robot room are for ANYmal C and scale with the robot's size.
PASSAGE = 1.0
"""Smallest distance between two pillars [m]. A robot 0.6 m wide fits through, so every target can be reached."""
CLEAR_RADIUS = 1.2
"""Smallest distance of a pillar from the start [m]."""
STANDING_RADIUS = 0.5
"""Targets closer to a pillar than this are invalid [m], so that the robot has room to stand there."""
MAX_PILLARS = 34
"""Largest number of pillars on a tile, if that many fit."""
MAX_DARTS = 400
"""Number of random positions tried. Of the widest pillars, about a third of `MAX_PILLARS` fit."""
ROBOT_HALF_WIDTH = 0.3
"""A robot walking straight touches pillars closer to its path than this [m]."""
SHADOW_ANGLES = 720
"""Number of directions from the start in which pillars are searched: at most 5 cm apart at the targets' distance."""
TRAINING_HALF = 4.5
"""Half the edge of the square that contains the pillars' centres in training [m]. It is small enough that `MAX_PILLARS`
narrow pillars stand nearly as close together as in evaluation."""
EVALUATION_X = (1.2, 4.4)
"""Range of x of the pillars in the evaluation layout [m], which leaves room around start and target."""
EVALUATION_HALF_Y = 6.0
"""Largest distance of their centres from the straight line [m]: too far to walk around all of them."""


def build(side: float, rng: np.random.Generator, layout: Layout, size: float) -> Tile:
    """Square pillars at random positions with passages between. In evaluation, the first one blocks the straight line.

    In training, `side` is that of the widest pillars. The others are narrower, because narrow and wide pillars need
    different detours. The first level has few pillars, so low that a robot may step on them.

    Targets on and near pillars are invalid. Only targets that a straight walk from the start cannot reach count for the
    curriculum.
    """
    if layout == "training":
        low, high = np.full(2, -TRAINING_HALF), np.full(2, TRAINING_HALF)
        first = []
        height, most = _grown(side)
        sides = rng.uniform(NARROWEST, side, MAX_DARTS)
    else:
        low = np.array([EVALUATION_X[0] * size + side / 2, -EVALUATION_HALF_Y])
        high = np.array([EVALUATION_X[1] - side / 2, EVALUATION_HALF_Y])
        first = [rng.uniform((max(low[0], 2.2), -0.1), (min(high[0], 3.4), 0.1))]
        height, most = HEIGHT, MAX_PILLARS
        sides = np.full(MAX_DARTS, side)
    centers, sides = _throw_darts(first, rng.uniform(low, high, (MAX_DARTS, 2)), sides, most, size)
    pillars = [
        block((x - s / 2, x + s / 2), (y - s / 2, y + s / 2), height) for (x, y), s in zip(centers, sides, strict=True)
    ]
    palette = [LIGHT] + [ACCENT] * len(pillars)
    valid = ~dilate(_covered(centers, sides / 2), STANDING_RADIUS * size)
    hidden = _hidden(centers, sides / 2 + ROBOT_HALF_WIDTH * size)
    return assemble([square(GROUND_HALF, 0.0), *pillars], palette, valid, hidden, separates=False)


def _grown(side: float) -> tuple[float, int]:
    """Height [m] and largest number of pillars on a training level whose widest pillars have this side."""
    height = np.interp(side, (NARROWEST, FULL_HEIGHT_FROM), (LOWEST_HEIGHT, HEIGHT))
    return float(height), round(np.interp(side, (NARROWEST, MOST_FROM), (FEWEST, MAX_PILLARS)))


def _throw_darts(
    first: list[np.ndarray], darts: np.ndarray, sides: np.ndarray, most: int, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """(pillars, 2) centres and (pillars,) sides [m]: `first`, then darts that keep clear of the start and each other.

    Args:
        darts: (n, 2) positions to try [m].
        sides: (n,) side of the pillar at each of them [m]; `first` uses the first entries too.
        most: largest number of pillars.
        size: size of the robot.
    """
    passage, clear = PASSAGE * size, CLEAR_RADIUS * size
    centers, kept = list(first), list(sides[: len(first)])
    for dart, side in zip(darts, sides, strict=True):
        if len(centers) == most:
            break
        free = _distance(dart, side / 2) >= clear
        apart = (_distance(dart - other, (side + own) / 2) >= passage for other, own in zip(centers, kept, strict=True))
        if free and all(apart):
            centers.append(dart)
            kept.append(side)
    return np.array(centers), np.array(kept)


def _distance(offset: np.ndarray, half: float) -> float:
    """Distance [m] from a point to a square with this half edge whose centre is at `offset`.

    If `half` is the sum of two squares' half edges, it is the distance between the squares.
    """
    return float(np.linalg.norm(np.maximum(np.abs(offset) - half, 0.0)))


def _covered(centers: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """Cells under a pillar."""
    x, y = cell_grid()
    squares = (
        np.maximum(np.abs(x - center[0]), np.abs(y - center[1])) <= half
        for center, half in zip(centers, halves, strict=True)
    )
    return reduce(np.logical_or, squares, np.zeros((RASTER_SIZE, RASTER_SIZE), dtype=bool))


def _hidden(centers: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """Cells that a straight line from the origin reaches only through a square with one of these half edges."""
    angles = np.linspace(-np.pi, np.pi, SHADOW_ANGLES, endpoint=False)
    direction = np.stack([np.cos(angles), np.sin(angles)], axis=-1)[:, None]
    direction = np.where(np.abs(direction) < 1e-9, 1e-9, direction)
    sides = np.stack([(centers - halves[:, None]) / direction, (centers + halves[:, None]) / direction])
    entry, leave = sides.min(0).max(-1), sides.max(0).min(-1)
    first = np.where((entry < leave) & (leave > 0.0), entry, np.inf).min(-1)
    x, y = cell_grid()
    nearest = np.round((np.arctan2(y, x) + np.pi) / (2 * np.pi) * SHADOW_ANGLES).astype(int) % SHADOW_ANGLES
    return np.hypot(x, y) > first[nearest]


OBSTACLES = Family("obstacles", "pillars to walk around", "side", "m", NARROWEST, WIDEST, build, random=True)
