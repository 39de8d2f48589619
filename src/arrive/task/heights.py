"""The grid of terrain heights around the robot."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from arrive.fields import Interval, NotNegative, Positive, Range, Rule
from arrive.terrain.tile import RASTER_CELL, RASTER_HALF, RASTER_SIZE

CPU = torch.device("cpu")


@dataclass(frozen=True)
class HeightsConfig:
    """The observation `heights`: the ground around the robot."""

    MAIN: ClassVar[str] = "noise"

    noise: NotNegative = 0.1
    """Half-width of the uniform noise [m]."""
    scale: Positive = 5.0
    """Factor on the height samples that the policy receives [1/m]."""
    clip: Interval = (-1.0, 1.0)
    """Relative heights are clipped to this range [m]. They are measured down from a point 0.5 m below the base: -1 is
    ground 1 m above that point, 0.4 is ground 0.4 m below it. With a low upper limit, all ground that is too deep for
    the feet looks the same."""
    length: Annotated[float, Range(0.0, 2.0 * RASTER_HALF, above=True)] = 1.6
    """Extent of the grid along the heading [m]."""
    width: Annotated[float, Range(0.0, 2.0 * RASTER_HALF, above=True)] = 1.0
    """Extent of the grid across the heading [m]."""
    step: Annotated[float, Range(0.01, RASTER_HALF)] = 0.1
    """Distance between height samples [m]."""
    samples: Annotated[int, Range(1, 10)] = 1
    """Points per side of a square of `step`, over whose clipped heights a height sample is the mean. With 1, it is the
    height of its one point, and the policy does not see where between two samples an edge lies."""

    @property
    def reach_m(self) -> float:
        """Distance of the outermost point from the base [m]."""
        own = self.step * (self.samples - 1) / self.samples
        return math.hypot(*(round(extent / self.step) * self.step + own for extent in (self.length, self.width))) / 2

    def rules(self) -> tuple[Rule, ...]:
        """Conditions between fields."""
        return (Rule("clip", "two numbers, the first below 0, the second above 0", self.clip[0] < 0.0 < self.clip[1]),)


@dataclass(frozen=True)
class FootHeightsConfig:
    """The observation `foot_heights`: the ground around each foot, at the points of `heights` that are nearest.

    Scale, clipping and noise are those of `heights`. Not in the paper.
    """

    MAIN: ClassVar[str] = "enabled"

    enabled: bool = False
    """Whether the policy observes it."""
    length: Annotated[float, Range(0.0, 1.0)] = 0.3
    """Extent of the samples along the heading, the foot in their middle [m]."""
    width: Annotated[float, Range(0.0, 1.0)] = 0.1
    """Extent of the samples across the heading [m]."""
    step: Annotated[float, Range(0.01, 1.0)] = 0.05
    """Distance between samples [m]."""


class HeightGrid:
    """Square cells around the base, aligned with its heading, and the points at which their height is looked up.

    Cells and points have coordinates in the heading frame [m]. x runs slowest, both from negative to positive.
    """

    def __init__(self, config: HeightsConfig):
        """Place the cells and each one's `samples` x `samples` points."""
        x = _symmetric_range(config.length, config.step)
        y = _symmetric_range(config.width, config.step)
        self._shape, self._samples = (len(x), len(y)), config.samples
        self._spacing = config.step / config.samples
        within = (torch.arange(config.samples) - (config.samples - 1) / 2) * self._spacing
        self.cells = torch.cartesian_prod(x, y)
        """(cells, 2) centres."""
        self.points = torch.cartesian_prod(*((along[:, None] + within).flatten() for along in (x, y)))
        """(points, 2) a regular grid."""
        self._low = self.points[0].tolist()

    def pooled(self, values: Tensor) -> Tensor:
        """(n, cells) means over the points of each cell of (n, points) values."""
        if self._samples == 1:
            return values
        rows, columns = self._shape
        return values.view(-1, rows, self._samples, columns, self._samples).mean((2, 4)).flatten(1)

    def spread(self, values: Tensor) -> Tensor:
        """(n, points) values at the points of (n, cells) values, the same for all points of a cell."""
        cells = values.view(-1, *self._shape)
        return cells.repeat_interleave(self._samples, 1).repeat_interleave(self._samples, 2).flatten(1)

    def nearest(self, x: Tensor, y: Tensor) -> Tensor:
        """Index of the point nearest to each place; x and y in the heading frame are broadcast together [m]."""
        rows, columns = (count * self._samples for count in self._shape)
        row, column = (((along - low) / self._spacing).round() for along, low in zip((x, y), self._low, strict=True))
        return (row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)).long()

    def reverse(self) -> list[int]:
        """For each cell, the index of its front-back mirror image."""
        return _reverse(*self._shape)


class FootGrid:
    """The samples around a foot: a regular grid, aligned with the heading, the foot in its middle. x runs slowest."""

    def __init__(self, config: FootHeightsConfig):
        """Prepare the samples' places."""
        self._config = config
        x, y = self._offsets(CPU)
        self._shape = len(x), len(y)
        self.offsets = torch.cartesian_prod(x, y)
        """(samples, 2) from the foot, in the heading frame [m]."""

    def around(self, feet: Tensor) -> tuple[Tensor, Tensor]:
        """(n, feet, rows, 1) x and (n, feet, 1, columns) y of the samples around (n, feet, 2) feet [m]."""
        x, y = self._offsets(feet.device)
        return feet[..., :1, None] + x[:, None], feet[..., 1:, None] + y

    def reverse(self) -> list[int]:
        """For each sample, the index of its front-back mirror image."""
        return _reverse(*self._shape)

    def _offsets(self, device: torch.device) -> tuple[Tensor, Tensor]:
        config = self._config
        x, y = (_symmetric_range(extent, config.step, device) for extent in (config.length, config.width))
        return x, y


def _reverse(rows: int, columns: int) -> list[int]:
    return [(rows - 1 - i // columns) * columns + i % columns for i in range(rows * columns)]


def _symmetric_range(extent: float, step: float, device: torch.device = CPU) -> Tensor:
    count = round(extent / step)
    return (torch.arange(count + 1, device=device) - count / 2) * step


def look_up(rasters: Tensor, raster_ids: Tensor, points_w: Tensor) -> Tensor:
    """Values of the raster cells that contain the points.

    Args:
        rasters: (num_rasters, RASTER_SIZE, RASTER_SIZE).
        raster_ids: (n,) the raster of each row.
        points_w: (n, k, 2) horizontal positions in the tile's frame [m]. Points outside the raster take the value at
            its edge.

    Returns:
        (n, k) values.
    """
    cells = ((points_w + RASTER_HALF) * (1.0 / RASTER_CELL)).long().clamp_(0, RASTER_SIZE - 1)
    flat = cells[..., 0] * RASTER_SIZE + cells[..., 1] + (raster_ids * RASTER_SIZE**2).unsqueeze(-1)
    return rasters.view(-1)[flat]


def grid_heights(rasters: Tensor, raster_ids: Tensor, points: Tensor, base_pos_w: Tensor, yaw: Tensor) -> Tensor:
    """The same as `look_up` at grid points around each base, ten times as fast: one matrix product for all points.

    Args:
        rasters: (num_rasters, RASTER_SIZE, RASTER_SIZE) float32.
        raster_ids: (n,) the raster of each row.
        points: (k, 2) in the heading frame [m].
        base_pos_w: (n, 3) in the tile's frame [m].
        yaw: (n,) headings [rad].

    Returns:
        (n, k) values.
    """
    n, k = len(raster_ids), len(points)
    x, y = points.T / RASTER_CELL
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    to_cells = torch.stack([torch.cat(pair) for pair in ((x, y), (-y, x), (one, zero), (zero, one))])
    origin = (base_pos_w[:, :2] + RASTER_HALF) / RASTER_CELL
    pose = torch.cat([yaw.cos().unsqueeze(-1), yaw.sin().unsqueeze(-1), origin], dim=-1)
    cells = (pose @ to_cells).clamp_(0, RASTER_SIZE - 1).floor_()
    # Cell numbers are small enough to be exact in float32.
    flat = torch.add(cells[:, k:], cells[:, :k], alpha=RASTER_SIZE).int()
    flat += (raster_ids * RASTER_SIZE**2).int().unsqueeze(-1)
    return rasters.view(-1).index_select(0, flat.view(-1)).view(n, k)
