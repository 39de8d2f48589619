"""All tiles and worlds of a run. They are built once, and environments choose among them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch
from torch import Tensor

from arrive.physics.options import PhysicsConfig
from arrive.physics.world import compile_world
from arrive.robots.robot import Robot
from arrive.terrain import Family, Layout, Tile, build_tile
from arrive.terrain.build import TARGET_DISTANCE
from arrive.terrain.rasters import Rasters, stack_rasters


@dataclass(frozen=True)
class TileSet:
    """The tiles of a run."""

    families: tuple[Family, ...]
    values: tuple[tuple[float, ...], ...]
    """Parameters to build for each family, easiest first."""
    layout: Layout
    variants: int
    """Worlds per family and level."""
    target_distance: tuple[float, float] = TARGET_DISTANCE
    """How far from the start training's targets are drawn [m]."""


@dataclass(frozen=True)
class WorldRandomisation:
    """Differences between worlds. They belong to worlds, because a robot gets a random world at each reset."""

    friction: tuple[float, float]
    """Sliding friction of every contact, uniform."""
    payload_kg: tuple[float, float]
    """Mass added to the base, uniform [kg]."""


@dataclass(frozen=True)
class WorldPool:
    """Worlds by family, level and variant."""

    families: tuple[Family, ...]
    values: tuple[tuple[float, ...], ...]
    """Physical parameter of each level of each family. A family without one has a single level."""
    worlds: tuple[mujoco.MjModel, ...]
    world_index: Tensor
    """(families, levels, variants) index into `worlds`; missing levels of a family repeat its last one."""
    tile_of_world: Tensor
    """(worlds,) index into the rasters."""
    rasters: Rasters
    tiles: tuple[Tile, ...]
    """The tiles. Their rasters are views of `rasters`."""

    @property
    def num_levels(self) -> tuple[int, ...]:
        """Number of levels of each family."""
        return tuple(len(values) for values in self.values)

    def to(self, device: torch.device) -> "WorldPool":
        """The pool with its lookup tables on a device. Worlds and tiles stay in the CPU's memory."""
        return replace(
            self,
            rasters=self.rasters.to(device),
            world_index=self.world_index.to(device),
            tile_of_world=self.tile_of_world.to(device),
        )


def build_pool(
    robot: Robot,
    tile_set: TileSet,
    spread: WorldRandomisation,
    physics: PhysicsConfig,
    seed: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> WorldPool:
    """Build every tile and compile every world of a run.

    Args:
        progress: called with the number of worlds compiled so far and their total.
    """
    rng = np.random.default_rng(seed)
    tiles: list[Tile] = []
    drawn: list[tuple[int, float, float]] = []
    most = max(len(levels) for levels in tile_set.values)
    index = torch.zeros(len(tile_set.families), most, tile_set.variants, dtype=torch.long)
    for f, (family, levels) in enumerate(zip(tile_set.families, tile_set.values, strict=True)):
        for level, value in enumerate(levels):
            for variant in range(tile_set.variants):
                if variant == 0 or family.random:
                    tiles.append(build_tile(family, value, rng, tile_set.layout, robot.size, tile_set.target_distance))
                index[f, level, variant] = len(drawn)
                drawn.append((len(tiles) - 1, rng.uniform(*spread.friction), rng.uniform(*spread.payload_kg)))
        index[f, len(levels) :] = index[f, len(levels) - 1]
    places = max(tile.num_geoms for tile in tiles)
    worlds: list[mujoco.MjModel] = []
    for tile, friction, payload_kg in drawn:
        worlds.append(compile_world(robot, tiles[tile], physics, friction, payload_kg, places=places))
        progress(len(worlds), len(drawn))
    rasters = stack_rasters(tiles)
    return WorldPool(
        families=tile_set.families,
        values=tile_set.values,
        worlds=tuple(worlds),
        world_index=index,
        tile_of_world=torch.tensor([tile for tile, _, _ in drawn]),
        rasters=rasters,
        tiles=tuple(rasters.shared_with(tile, i) for i, tile in enumerate(tiles)),
    )
