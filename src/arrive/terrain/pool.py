"""All tiles and worlds of a run, built once: environments only ever choose among them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch
from torch import Tensor

from arrive.config import Config
from arrive.errors import ArriveError
from arrive.physics.world import compile_world
from arrive.robots.robot import Robot
from arrive.terrain import Family, Layout, Tile, build_tile

EVALUATION_SEED_OFFSET = 1_000_003
"""Keeps the terrain that policies are evaluated on apart from what they were trained on."""


@dataclass(frozen=True)
class Rasters:
    """The tiles' rasters, stacked; each is (num_tiles, RASTER_SIZE, RASTER_SIZE)."""

    heights: Tensor
    target_valid: Tensor
    crossing: Tensor
    fall_height: Tensor
    """(num_tiles,) [m]."""
    parted: Tensor
    """(num_tiles,) bool."""


@dataclass(frozen=True)
class TerrainPool:
    """Worlds by family, level and variant."""

    families: tuple[Family, ...]
    values: tuple[tuple[float, ...], ...]
    """Physical parameter of each level of each family; a family without one has a single level."""
    worlds: tuple[mujoco.MjModel, ...]
    world_index: Tensor
    """(families, levels, variants) index into `worlds`; levels a family lacks repeat its last one."""
    tile_of_world: Tensor
    """(worlds,) index into the rasters."""
    rasters: Rasters
    tiles: tuple[Tile, ...]
    """The tiles themselves; their rasters are views of `rasters`."""

    @property
    def num_levels(self) -> tuple[int, ...]:
        """Number of levels of each family."""
        return tuple(len(values) for values in self.values)

    def to(self, device: torch.device) -> "TerrainPool":
        """The pool with what the environment looks up on a device; worlds and tiles stay in the CPU's memory."""
        rasters = Rasters(**{name: value.to(device) for name, value in vars(self.rasters).items()})
        return replace(
            self,
            rasters=rasters,
            world_index=self.world_index.to(device),
            tile_of_world=self.tile_of_world.to(device),
        )


def level_values(family: Family, num_levels: int) -> tuple[float, ...]:
    """Parameters of a family's levels; one level for a family whose parameter does not vary."""
    if num_levels < 1:
        raise ArriveError(f"terrain.levels must be at least 1, not {num_levels}")
    count = 1 if family.lowest == family.highest else num_levels
    return tuple(family.value(level, count) for level in range(count))


def build_pool(
    config: Config,
    robot: Robot,
    families: Sequence[Family],
    values: Sequence[Sequence[float]],
    layout: Layout,
    seed: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TerrainPool:
    """Build every tile and compile every world of a run.

    Friction and payload are dealt to worlds, not to environments: a robot draws a new world at each reset.

    Args:
        values: parameters to build for each family, easiest first.
        progress: told worlds compiled so far and their number.
    """
    rng = np.random.default_rng(seed)
    variants = config.terrain.variants
    tiles: list[Tile] = []
    worlds: list[mujoco.MjModel] = []
    tile_of_world: list[int] = []
    total = variants * sum(len(levels) for levels in values)
    index = torch.zeros(len(families), max(len(levels) for levels in values), variants, dtype=torch.long)
    for f, (family, levels) in enumerate(zip(families, values, strict=True)):
        for level, value in enumerate(levels):
            for variant in range(variants):
                if variant == 0 or family.random:
                    tiles.append(build_tile(family, value, rng, layout))
                index[f, level, variant] = len(worlds)
                tile_of_world.append(len(tiles) - 1)
                worlds.append(_deal_world(config, robot, tiles[-1], rng))
                progress(len(worlds), total)
        index[f, len(levels) :] = index[f, len(levels) - 1]
    rasters = stack_rasters(tiles)
    return TerrainPool(
        families=tuple(families),
        values=tuple(map(tuple, values)),
        worlds=tuple(worlds),
        world_index=index,
        tile_of_world=torch.tensor(tile_of_world),
        rasters=rasters,
        tiles=tuple(_share(tile, rasters, i) for i, tile in enumerate(tiles)),
    )


def _deal_world(config: Config, robot: Robot, tile: Tile, rng: np.random.Generator) -> mujoco.MjModel:
    friction = rng.uniform(*config.randomisation.friction)
    payload = rng.uniform(*config.randomisation.payload_kg)
    return compile_world(robot, tile, config.physics, friction, payload)


def stack_rasters(tiles: Sequence[Tile]) -> Rasters:
    """The rasters of these tiles, in their order."""
    return Rasters(
        heights=torch.from_numpy(np.stack([tile.heights for tile in tiles])),
        target_valid=torch.from_numpy(np.stack([tile.target_valid for tile in tiles])),
        crossing=torch.from_numpy(np.stack([tile.crossing for tile in tiles])),
        fall_height=torch.tensor([tile.fall_height for tile in tiles], dtype=torch.float32),
        parted=torch.tensor([tile.parted for tile in tiles]),
    )


def _share(tile: Tile, rasters: Rasters, index: int) -> Tile:
    """The tile with its rasters taken from the stack, so that they are kept once."""
    return replace(
        tile,
        heights=rasters.heights[index].numpy(),
        target_valid=rasters.target_valid[index].numpy(),
        crossing=rasters.crossing[index].numpy(),
    )
