"""A tile: the small piece of ground that one environment stands on."""

from dataclasses import dataclass, field

import numpy as np

RASTER_CELL = 0.05
"""Edge of a raster cell [m]."""
RASTER_HALF = 7.0
"""Half the edge of the square that rasters cover, centred at the tile's origin [m]."""
RASTER_SIZE = round(2 * RASTER_HALF / RASTER_CELL)
MAX_GEOMS = 64
"""Most shapes of a tile."""

START_RADIUS = 0.4
"""The ground is level this far around the start of a robot of ANYmal C's size [m]."""


@dataclass(frozen=True)
class Box:
    """A solid box of the ground, in the tile's frame [m]; `quat` is (w, x, y, z)."""

    center: tuple[float, float, float]
    half_size: tuple[float, float, float]
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class HeightField:
    """A MuJoCo height field centred at the tile's origin: vertex heights on a regular grid over a square."""

    heights: np.ndarray
    """(n, n) heights [m], first index x, second y, both ascending."""
    half_extent: float
    """Half the edge of the square [m]."""


@dataclass(frozen=True, eq=False)
class Tile:
    """One piece of terrain, with the robot's start at the origin on ground of height zero.

    Rasters are (RASTER_SIZE, RASTER_SIZE), first index x, second y; cell (i, j) is centred at
    (-RASTER_HALF + (i + 0.5) * RASTER_CELL, the same for j).
    """

    boxes: tuple[Box, ...]
    heights: np.ndarray
    """float32 raster: height of the ground at each cell's centre [m]."""
    target_valid: np.ndarray
    """bool raster: a target is allowed here (paper: not in a hole and not on a high obstacle)."""
    crossing: np.ndarray
    """bool raster: this cell lies beyond the terrain, as seen from the start. Only targets on such cells count for the
    curriculum."""
    separates: bool = True
    """Whether the terrain separates the start from all crossing cells, as a gap does and pillars do not. If so, a robot
    on another cell has not crossed the terrain."""
    height_field: HeightField | None = None
    fall_height: float = -np.inf
    """A base below this height has fallen into a hole [m]."""
    palette: tuple[tuple[float, float, float], ...] = field(default=())
    """Optional RGB colour of each box and then of the height field; the rest is grey."""

    @property
    def num_geoms(self) -> int:
        """Number of its shapes."""
        return len(self.boxes) + (self.height_field is not None)


def cell_centers() -> np.ndarray:
    """(RASTER_SIZE,) coordinates of the raster's cell centres along one axis [m]."""
    return (np.arange(RASTER_SIZE) + 0.5) * RASTER_CELL - RASTER_HALF


def cell_index(coordinate: np.ndarray) -> np.ndarray:
    """Raster index of a coordinate [m], clamped to the raster."""
    return np.clip(((coordinate + RASTER_HALF) / RASTER_CELL).astype(np.int64), 0, RASTER_SIZE - 1)
