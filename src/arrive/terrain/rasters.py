"""The stacked rasters of all tiles, in which each robot looks up its own tile."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from arrive.terrain.tile import Tile


@dataclass(frozen=True)
class Rasters:
    """The tiles' rasters, stacked; each is (num_tiles, RASTER_SIZE, RASTER_SIZE)."""

    heights: Tensor
    target_valid: Tensor
    crossing: Tensor
    fall_height: Tensor
    """(num_tiles,) see `Tile.fall_height` [m]."""
    separates: Tensor
    """(num_tiles,) bool, see `Tile.separates`."""

    def to(self, device: torch.device) -> "Rasters":
        """The same on a device."""
        return Rasters(**{name: value.to(device) for name, value in vars(self).items()})

    def shared_with(self, tile: Tile, index: int) -> Tile:
        """The tile with its rasters replaced by views of the stack, so that they are kept in memory only once."""
        return replace(
            tile,
            heights=self.heights[index].numpy(),
            target_valid=self.target_valid[index].numpy(),
            crossing=self.crossing[index].numpy(),
        )


def stack_rasters(tiles: Sequence[Tile]) -> Rasters:
    """The rasters of these tiles, in their order."""
    return Rasters(
        heights=torch.from_numpy(np.stack([tile.heights for tile in tiles])),
        target_valid=torch.from_numpy(np.stack([tile.target_valid for tile in tiles])),
        crossing=torch.from_numpy(np.stack([tile.crossing for tile in tiles])),
        fall_height=torch.tensor([tile.fall_height for tile in tiles], dtype=torch.float32),
        separates=torch.tensor([tile.separates for tile in tiles]),
    )
