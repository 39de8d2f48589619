"""The pool of a run's worlds."""

import pytest
import torch

from arrive.physics import PhysicsConfig
from arrive.physics.pool import TileSet, WorldRandomisation, build_pool
from arrive.robots import get_robot
from arrive.terrain import get_family

SPREAD = WorldRandomisation(friction=(0.5, 1.0), payload_kg=(-5.0, 5.0))


def test_worlds_have_one_number_of_terrain_geoms_which_the_largest_tile_needs():
    tiles = TileSet((get_family("pit"), get_family("gap")), ((0.1, 0.4), (0.3,)), "training", 2)
    pool = build_pool(get_robot("anymal_c"), tiles, SPREAD, PhysicsConfig(), seed=0)
    largest = max(tile.num_geoms for tile in pool.tiles)
    assert largest > min(tile.num_geoms for tile in pool.tiles)
    assert {int(world.body_geomnum[0]) for world in pool.worlds} == {largest}


def test_each_world_has_its_own_tile_friction_and_payload():
    tiles = TileSet((get_family("pit"),), ((0.1, 0.4),), "training", 3)
    told = []
    pool = build_pool(
        get_robot("anymal_c"), tiles, SPREAD, PhysicsConfig(), 0, lambda done, total: told.append((done, total))
    )
    assert told == [(done, 6) for done in range(1, 7)]
    assert torch.equal(pool.world_index, torch.arange(6).view(1, 2, 3))
    assert pool.tile_of_world.tolist() == [0, 0, 0, 1, 1, 1]
    depths = [pool.tiles[tile].heights.max() for tile in pool.tile_of_world.tolist()]
    for world, depth in zip(pool.worlds, depths, strict=True):
        assert (world.geom_pos[:, 2] + world.geom_size[:, 2])[: world.body_geomnum[0]].max() == pytest.approx(depth)
    assert len({float(world.geom_friction[0, 0]) for world in pool.worlds}) == 6
    assert len({float(world.body("base").mass[0]) for world in pool.worlds}) == 6
