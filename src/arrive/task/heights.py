"""The grid of terrain heights around the robot."""

from functools import cached_property

import torch
from torch import Tensor

from arrive.config import ObservationConfig
from arrive.terrain.tile import RASTER_CELL, RASTER_HALF, RASTER_SIZE


class HeightGrid:
    """Points around the base, aligned with its heading, at which the ground's height is looked up."""

    def __init__(self, config: ObservationConfig):
        self._length, self._width, self._step = config.grid_length, config.grid_width, config.grid_step

    @cached_property
    def points(self) -> Tensor:
        """(points, 2) in the heading frame [m]; x runs slowest, both from negative to positive."""
        x = _symmetric_range(self._length, self._step)
        y = _symmetric_range(self._width, self._step)
        return torch.cartesian_prod(x, y)

    def mirror(self) -> list[int]:
        """For each point, the index of its left-right mirror image."""
        count_y = len(_symmetric_range(self._width, self._step))
        return [i - i % count_y + count_y - 1 - i % count_y for i in range(len(self.points))]


def _symmetric_range(extent: float, step: float) -> Tensor:
    count = round(extent / step)
    return (torch.arange(count + 1) - count / 2) * step


def look_up(rasters: Tensor, raster_ids: Tensor, points_w: Tensor) -> Tensor:
    """Values of the raster cells that points lie in.

    Args:
        rasters: (num_rasters, RASTER_SIZE, RASTER_SIZE).
        raster_ids: (n,) the raster of each row.
        points_w: (n, k, 2) horizontal positions in the tile's frame [m]; beyond the raster its edge counts.

    Returns:
        (n, k) values.
    """
    cells = ((points_w + RASTER_HALF) * (1.0 / RASTER_CELL)).long().clamp_(0, RASTER_SIZE - 1)
    flat = cells[..., 0] * RASTER_SIZE + cells[..., 1] + (raster_ids * RASTER_SIZE**2).unsqueeze(-1)
    return rasters.view(-1)[flat]


def heading_points(points: Tensor, base_pos_w: Tensor, yaw: Tensor) -> Tensor:
    """(n, points, 2) grid points in the world frame for (n, 3) base positions and (n,) headings."""
    cos, sin = torch.cos(yaw).unsqueeze(-1), torch.sin(yaw).unsqueeze(-1)
    x, y = points[:, 0], points[:, 1]
    return torch.stack([base_pos_w[:, :1] + cos * x - sin * y, base_pos_w[:, 1:2] + sin * x + cos * y], dim=-1)
