"""Heights of the ground under every cell of a tile's raster, and masks over its cells."""

from collections.abc import Sequence

import numpy as np

from arrive.rotation import matrix
from arrive.terrain.tile import RASTER_CELL, RASTER_SIZE, Box, HeightField, Tile, cell_centers

DEEP_FLOOR = -20.0
"""Height of cells with nothing under them [m]; `build_tile` refuses tiles that have any."""


def assemble(
    boxes: Sequence[Box],
    palette: Sequence[tuple[float, float, float]] = (),
    target_valid: np.ndarray | None = None,
    crossing: np.ndarray | None = None,
    height_field: HeightField | None = None,
    fall_height: float = -np.inf,
    separates: bool = True,
) -> Tile:
    """A tile of these shapes with its height raster. A mask that is None is true everywhere."""
    everywhere = np.ones((RASTER_SIZE, RASTER_SIZE), dtype=bool)
    return Tile(
        boxes=tuple(boxes),
        heights=rasterise(boxes, height_field),
        target_valid=everywhere if target_valid is None else target_valid,
        crossing=everywhere if crossing is None else crossing,
        separates=separates,
        height_field=height_field,
        fall_height=fall_height,
        palette=tuple(palette),
    )


def rasterise(boxes: Sequence[Box], height_field: HeightField | None = None) -> np.ndarray:
    """(RASTER_SIZE, RASTER_SIZE) float32 height of the topmost surface at each cell's centre [m]."""
    heights = np.full((RASTER_SIZE, RASTER_SIZE), DEEP_FLOOR)
    for box in boxes:
        _raise_to_box(heights, box)
    if height_field is not None:
        np.maximum(heights, height_field_heights(height_field), out=heights)
    return heights.astype(np.float32)


def _raise_to_box(heights: np.ndarray, box: Box) -> None:
    """Raise `heights` to the box's top, found by intersecting each cell's vertical line with the box."""
    rotation = matrix(np.array(box.quat))
    center, half = np.array(box.center), np.array(box.half_size)
    reach = np.abs(rotation) @ half
    x, y = (_cells_between(center[axis] - reach[axis], center[axis] + reach[axis]) for axis in (0, 1))
    area = heights[x, y]
    if np.array_equal(np.abs(rotation), np.eye(3)):
        np.maximum(area, center[2] + half[2], out=area)
        return
    dx, dy = np.meshgrid(cell_centers()[x] - center[0], cell_centers()[y] - center[1], indexing="ij")
    # In the box's frame the line is origin + z * direction, with z measured from the box's centre.
    origin = dx[..., None] * rotation[0] + dy[..., None] * rotation[1]
    direction = np.where(np.abs(rotation[2]) < 1e-12, 1e-12, rotation[2])
    near, far = (np.sign(direction) * side * half for side in (-1.0, 1.0))
    bottom = ((near - origin) / direction).max(-1)
    top = ((far - origin) / direction).min(-1)
    np.maximum(area, np.where(bottom <= top, center[2] + top, DEEP_FLOOR), out=area)


def _cells_between(low: float, high: float) -> slice:
    """The cells along one axis whose centres lie in [low, high] [m]."""
    centers = cell_centers()
    return slice(int(np.searchsorted(centers, low, "left")), int(np.searchsorted(centers, high, "right")))


def height_field_heights(field: HeightField) -> np.ndarray:
    """(RASTER_SIZE, RASTER_SIZE) height of the field's triangles at each cell's centre [m].

    MuJoCo cuts each square of the grid along the diagonal from its low-x, low-y to its high-x, high-y corner.
    """
    last = field.heights.shape[0] - 1
    position = np.clip((cell_centers() + field.half_extent) / (2 * field.half_extent) * last, 0, last)
    index = np.minimum(position.astype(np.int64), last - 1)
    fraction = position - index
    u, v = fraction[:, None], fraction[None, :]
    i, j = index[:, None], index[None, :]
    low, high = field.heights[i, j], field.heights[i + 1, j + 1]
    x_first, y_first = field.heights[i + 1, j], field.heights[i, j + 1]
    heights = np.where(
        u >= v, low + u * (x_first - low) + v * (high - x_first), low + v * (y_first - low) + u * (high - y_first)
    )
    outside = np.abs(cell_centers()) > field.half_extent
    heights[outside[:, None] | outside[None, :]] = DEEP_FLOOR
    return heights


def cell_grid() -> tuple[np.ndarray, np.ndarray]:
    """x (RASTER_SIZE, 1) and y (1, RASTER_SIZE) of the cells' centres [m], for building masks."""
    centers = cell_centers()
    return centers[:, None], centers[None, :]


def inside_square(half: float) -> np.ndarray:
    """Cells within the axis-aligned square with this half edge [m] around the origin."""
    x, y = cell_grid()
    return np.maximum(np.abs(x), np.abs(y)) <= half


def beyond_x(start: float) -> np.ndarray:
    """Cells with x greater than `start` [m]."""
    x, _ = cell_grid()
    return np.repeat(x > start, RASTER_SIZE, axis=1)


def dilate(mask: np.ndarray, radius: float) -> np.ndarray:
    """The cells within `radius` [m] of a cell of `mask`, between centres."""
    reach = int(radius / RASTER_CELL + 1e-9)
    grown = mask.copy()
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            if 0 < i * i + j * j <= (radius / RASTER_CELL) ** 2 + 1e-9:
                grown[_shifted(i), _shifted(j)] |= mask[_shifted(-i), _shifted(-j)]
    return grown


def _shifted(offset: int) -> slice:
    """The cells along one axis that remain on the raster when each is moved by -offset."""
    return slice(max(offset, 0), RASTER_SIZE + min(offset, 0))
