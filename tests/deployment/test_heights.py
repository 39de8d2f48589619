"""Heights under the grid of points, from maps and point clouds with holes in them."""

import math

import numpy as np
import pytest

from arrive.deployment import Controller, GridHeights, HeightMap
from arrive.deployment.heights import HeightSampler
from arrive.deployment.inputs import frame_of
from arrive.deployment.specs import GridSpec
from arrive.terrain.tile import RASTER_CELL, RASTER_HALF
from controllers import DT, POINTS, an_env, sensors_of, step


def small_grid() -> HeightSampler:
    """Five by five points, 0.1 m apart."""
    points = [[x / 10, y / 10] for x in range(-2, 3) for y in range(-2, 3)]
    return HeightSampler(GridSpec(points, 0.1, 0.5, 1.0))


def test_height_map_is_read_in_the_heading_frame():
    x, y = np.meshgrid(np.arange(-2, 2, 0.02) + 0.01, np.arange(-1, 1, 0.02) + 0.01, indexing="ij")
    grid, yaw = small_grid(), 0.7
    heights = grid.from_map(np.array([-2.0, -1.0]), 0.02, x + 10 * y, np.array([0.5, 0.2, 0.9]), yaw)
    for (px, py), height in zip(grid.points, heights, strict=True):
        wx = 0.5 + math.cos(yaw) * px - math.sin(yaw) * py
        wy = 0.2 + math.sin(yaw) * px + math.cos(yaw) * py
        assert height == pytest.approx(wx + 10 * wy, abs=0.12)
    beyond = grid.from_map(np.array([-2.0, -1.0]), 0.02, x, np.array([50.0, 0.0, 0.9]), yaw)
    assert np.isnan(beyond).all()


def test_map_of_a_tile_gives_the_heights_of_training(exported):
    env, controller = an_env("pit"), Controller.load(exported)
    for i in range(env.num_envs):
        raster = env.pool.rasters.heights[env.tile_of_env[i]].numpy()
        terrain = HeightMap((-RASTER_HALF, -RASTER_HALF), RASTER_CELL, raster, 0.0)
        frame = frame_of(sensors_of(env.state, i, 0.0), None, terrain, 0.0, controller._grid)
        # Rounding may put a point that lies on the border of two cells into the other one.
        assert np.isclose(frame.heights_w, env.state.heights_w[i]).mean() > 0.98


def test_point_cloud_gives_the_median_around_each_point():
    grid = small_grid()
    # The robot stands at (1, 0) and looks along y: its grid point (0.2, -0.1) is the world's (1.1, 0.2).
    points = np.array([[1.1, 0.2, 1.0], [1.12, 0.21, 2.0], [1.09, 0.19, 9.0], [1.1, 0.2, np.nan], [5.0, 5.0, 7.0]])
    heights = grid.from_cloud(points, np.array([1.0, 0.0, 0.5]), math.pi / 2)
    seen = np.flatnonzero(~np.isnan(heights))
    assert len(seen) == 1
    np.testing.assert_allclose(grid.points[seen[0]], (0.2, -0.1))
    assert heights[seen[0]] == 2.0
    assert np.isnan(grid.from_cloud(np.zeros((0, 3)), np.zeros(3), 0.0)).all()


def test_unseen_points_take_the_nearest_seen_height_else_the_ground_under_the_robot():
    grid = small_grid()
    heights = np.full(25, np.nan)
    heights[0] = 0.3  # at (-0.2, -0.2)
    heights[4] = 0.8  # at (-0.2, 0.2)
    filled, seen = grid.fill(heights, standing_on=-1.0)
    by_point = {(round(x, 1), round(y, 1)): h for (x, y), h in zip(grid.points, filled, strict=True)}
    assert by_point[-0.2, -0.1] == 0.3
    assert by_point[-0.1, 0.1] == 0.8
    assert by_point[0.0, -0.1] == 0.3
    assert by_point[0.2, 0.0] == -1.0
    assert seen == pytest.approx(np.mean([h != -1.0 for h in filled]))
    whole = np.arange(25.0)
    assert grid.fill(whole, -1.0)[0] is whole


def test_map_with_holes_is_walked_on_and_a_blind_one_is_not(controller):
    heights = np.zeros(POINTS)
    heights[::3] = np.nan
    assert step(controller, 0.0, terrain=GridHeights(heights, 0.0)).mode == "joystick"
    heights[: POINTS // 3] = np.nan
    command = step(controller, DT, terrain=GridHeights(heights, DT))
    assert command.mode == "joystick"
    assert "of the ground seen" in command.reason
    command = step(controller, 2 * DT, terrain=GridHeights(np.full(POINTS, np.nan), 2 * DT))
    assert (command.mode, command.reason) == ("safe", "only 0% of the ground was seen")
