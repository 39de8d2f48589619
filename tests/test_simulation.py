"""The single simulated robot: the physics, sensors and terminations of training, without torch."""

import dataclasses
import math
import subprocess
import sys

import mujoco
import numpy as np
import pytest
import torch

from arrive.config import override
from arrive.deployment.heights import HeightSampler
from arrive.deployment.policy_file import GridSpec
from arrive.errors import ArriveError
from arrive.physics.cpu import CpuPhysics
from arrive.physics.world import compile_world
from arrive.presets import robust
from arrive.robots import ROBOTS
from arrive.simulation import DROP, FAR, SimulatedRobot, continued
from arrive.sizing import for_robot
from arrive.task.heights import HeightGrid, grid_heights
from arrive.terrain import FAMILIES
from arrive.terrain.ground import ground_of

CONFIG = robust()
FLAT = ground_of("flat").build()
FOLDED = np.array([0.0, 1.5, -2.7, 0.0, -1.5, 2.7] * 2)


def standing(robot: SimulatedRobot, steps: int) -> None:
    """Hold the default pose."""
    for _ in range(steps):
        robot.step(np.array(robot.robot.default_joint_pos))


def test_importing_and_stepping_needs_no_torch():
    program = (
        "import sys\n"
        "from types import SimpleNamespace\n"
        "from arrive.physics.options import PhysicsConfig\n"
        "from arrive.simulation import SimulatedRobot\n"
        "from arrive.terrain.ground import ground_of\n"
        "observation = SimpleNamespace(heights=SimpleNamespace(reach_m=1.0))\n"
        "config = SimpleNamespace(robot='anymal_c', physics=PhysicsConfig(), observation=observation)\n"
        "robot = SimulatedRobot(config, ground_of('gap', 3).build())\n"
        "robot.step(robot.sensors().joint_pos)\n"
        "sys.exit('torch' in sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0


def test_physics_is_bit_identical_to_trainings():
    robot = SimulatedRobot(CONFIG, ground_of("rough", 9).build(), friction=0.8, payload_kg=2.0)
    world = compile_world(robot.robot, robot.tile, CONFIG.physics, 0.8, 2.0)
    physics = CpuPhysics(robot.robot, [world], CONFIG.physics, 1, threads=1)
    start = torch.from_numpy(robot.data.qpos.copy())[None]
    physics.reset(torch.tensor([0]), start, torch.zeros(1, 18, dtype=torch.double))
    rng, crashes = np.random.default_rng(0), 0
    for step in range(150):
        targets = (robot.robot.default_joint_pos if step < 75 else FOLDED) + rng.normal(0.0, 0.5, 12)
        robot.step(targets)
        physics.step(torch.from_numpy(targets)[None])
        readings, sensors = physics.read(), robot.sensors()
        np.testing.assert_array_equal(readings.joint_pos[0].numpy(), sensors.joint_pos.astype(np.float32))
        np.testing.assert_array_equal(readings.base_pos_w[0].numpy(), sensors.base_pos_w.astype(np.float32))
        np.testing.assert_array_equal(readings.base_ang_vel_b[0].numpy(), sensors.base_ang_vel_b.astype(np.float32))
        assert bool(readings.crash_contacts[0] > 0) == robot.crashed
        crashes += robot.crashed
    assert 0 < crashes < 75


def test_a_control_step_lasts_20_ms_and_a_standing_robot_stays():
    robot = SimulatedRobot(CONFIG, FLAT)
    robot.reset((1.0, -2.0), 0.5)
    standing(robot, 50)
    assert robot.time_s == pytest.approx(1.0)
    np.testing.assert_allclose(robot.base_pos_w[:2], [1.0, -2.0], atol=0.02)
    # Under PD it sags by 3 cm, as in `robots/test_anymal_c.py`.
    assert robot.base_pos_w[2] == pytest.approx(robot.robot.standing_height, abs=0.05)
    assert robot.yaw == pytest.approx(0.5, abs=0.02)
    assert not robot.crashed
    assert not robot.fell


def test_a_push_is_felt_in_the_base_frame():
    robot = SimulatedRobot(CONFIG, FLAT)
    robot.reset(yaw=math.pi / 2)
    robot.push((1.0, 0.0))
    np.testing.assert_allclose(robot.base_lin_vel_w, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(robot.sensors().base_lin_vel_b, [0.0, -1.0, 0.0], atol=1e-12)


def test_a_robot_without_torque_crashes_and_a_reset_clears_the_crash():
    robot = SimulatedRobot(CONFIG, FLAT)
    for _ in range(100):
        robot.step(FOLDED)
    assert robot.crashed
    robot.reset()
    assert not robot.crashed
    first = robot.sensors()
    standing(robot, 10)
    robot.reset()
    for name, value in vars(robot.sensors()).items():
        np.testing.assert_array_equal(value, getattr(first, name))


def test_a_diverged_simulation_is_a_crash():
    robot = SimulatedRobot(CONFIG, FLAT)
    robot.data.qvel[7] = np.nan
    assert robot.crashed
    robot.reset()
    robot.data.qvel[:3] = 1e4
    assert robot.crashed


def test_a_robot_in_the_gap_fell():
    robot = SimulatedRobot(CONFIG, ground_of("gap=1.4").build())
    assert not robot.fell
    robot.reset((1.9, 0.0))
    assert robot.fell


@pytest.mark.parametrize("family", FAMILIES)
def test_the_height_map_is_what_training_looks_up(family):
    robot = SimulatedRobot(CONFIG, ground_of(family, 9, layout="training").build())
    grid = HeightGrid(CONFIG.observation.heights)
    deployed = HeightSampler(GridSpec(grid.points.tolist(), 0.1, 0.5, 1.0))
    rng, raster = np.random.default_rng(0), torch.from_numpy(robot.tile.heights)[None]
    for _ in range(20):
        x, y, yaw = *rng.uniform(-7.5, 7.5, 2), rng.uniform(-np.pi, np.pi)
        robot.reset((x, y), yaw)
        terrain, pos = robot.height_map(), robot.base_pos_w
        mine = deployed.from_map(terrain.origin_w, terrain.resolution_m, terrain.heights_w, pos, robot.yaw)
        base, yaw = torch.from_numpy(pos)[None].float(), torch.tensor([robot.yaw]).float()
        expected = grid_heights(raster, torch.tensor([0]), grid.points, base, yaw)[0].numpy()
        # A grid point on the border of two cells may fall into either by rounding.
        assert np.mean(mine != expected) < 0.02


@pytest.mark.parametrize("shape", [(1.6, 1.0, 0.1, 1), (0.5, 0.3, 0.2, 3), (5.0, 3.1, 0.25, 2)])
def test_the_height_map_covers_the_policys_whole_grid(shape):
    """At every heading, and with a map that is from half a metre ago. The middle one is not a whole number of steps."""
    names = ("length", "width", "step", "samples")
    config = override(CONFIG, tuple(f"observation.heights.{n}={v}" for n, v in zip(names, shape, strict=True)))
    points = HeightGrid(config.observation.heights).points
    assert config.observation.heights.reach_m == pytest.approx(float(points.norm(dim=-1).max()), abs=1e-5)
    robot, sampler = SimulatedRobot(config, FLAT), HeightSampler(GridSpec(points.tolist(), shape[2], 0.5, 1.0))
    robot.reset((1.234, -2.345))
    seen = robot.height_map()
    for yaw in np.linspace(-np.pi, np.pi, 24):
        moved = robot.base_pos_w + 0.5 * np.array([math.cos(3 * yaw), math.sin(3 * yaw), 0.0])
        heights = sampler.from_map(seen.origin_w, seen.resolution_m, seen.heights_w, moved, yaw)
        assert not np.isnan(heights).any()


def test_continued_ground_goes_on_and_the_tile_itself_ends():
    pit = ground_of("pit=0.3").build()
    for tile, falls in ((pit, True), (continued(pit), False), (continued(ground_of("gap=0.5").build()), False)):
        robot = SimulatedRobot(CONFIG, tile)
        robot.reset((50.0, -30.0))
        standing(robot, 50)
        assert robot.left_ground == falls
        assert (robot.base_pos_w[2] < 0.0) == falls
    robot.reset((FAR + 1.0, 0.0))
    assert robot.left_ground
    assert continued(ground_of("rough").build()).height_field is not None
    # The gap's walls, which do not lie at the edge, stay where they are.
    gap, wide = ground_of("gap").build(), continued(ground_of("gap").build())
    assert gap.boxes[1] == wide.boxes[1]


def test_a_robot_starts_above_the_highest_ground_under_it():
    robot = SimulatedRobot(CONFIG, ground_of("pit=0.8").build())
    robot.reset((1.5, 0.0))
    assert robot.base_pos_w[2] > 0.8 + robot.robot.standing_height
    assert not robot.crashed


@pytest.mark.parametrize("name", ["anymal_c", "go2"])
def test_a_robot_before_a_staircase_starts_on_the_ground_in_front_of_it(name):
    """As in the protocol: it must not fall a step's height at the start."""
    config = for_robot(CONFIG, ROBOTS[name])
    robot = SimulatedRobot(config, ground_of("stairs=0.2", layout="evaluation").build(size=ROBOTS[name].size))
    assert robot.base_pos_w[2] == pytest.approx(robot.robot.standing_height, abs=1.5 * DROP)
    robot.reset((0.3, 0.0))
    assert robot.base_pos_w[2] == pytest.approx(0.2 + robot.robot.standing_height, abs=1.5 * DROP)


def test_visuals_do_not_change_the_physics():
    plain, drawn = (SimulatedRobot(CONFIG, FLAT, visuals=visuals) for visuals in (False, True))
    for robot in (plain, drawn):
        standing(robot, 20)
    np.testing.assert_array_equal(plain.data.qpos, drawn.data.qpos)
    assert drawn.model.ngeom > plain.model.ngeom


def test_ground_by_name_level_and_value():
    same, other = (ground_of("rough", 9).build(seed).heights for seed in (1, 2))
    np.testing.assert_array_equal(same, ground_of("rough", 9).build().heights)
    assert not np.array_equal(same, other)
    assert ground_of("stairs", 9, layout="evaluation").build().heights.max() == pytest.approx(13 * 0.45)
    # A level is one of the policy's own, a value is the parameter itself.
    assert ground_of("gap", 2, levels=20).value == pytest.approx(0.02 + 2 * 1.38 / 19)
    assert ground_of(" gap = 0.4 ").words == "a gap to leap over, width 0.4 m"
    assert ground_of("flat").words == "flat ground"
    for mistake, part in (
        (("moon",), "unknown terrain"),
        (("gap", 10), "levels are 0 to 9"),
        (("gap=0.5", 1), "not both"),
        (("gap=nan",), "0.02 to 1.4 m"),
        (("gap=",), "0.02 to 1.4 m"),
        (("slope=1e9",), "0 to 55 deg"),
        (("flat=0",), "no parameter"),
    ):
        with pytest.raises(ArriveError, match=part):
            ground_of(*mistake)


@pytest.mark.parametrize(("terrain", "layout", "goes_on"), [
    ("slope=20", "evaluation", True), ("slope_down=20", "evaluation", True), ("stairs=0.2", "evaluation", True),
    ("slope=20", "training", False), ("slope_down=20", "training", False),
])  # fmt: skip
def test_tilted_ground_goes_on_where_it_can(terrain, layout, goes_on):
    tile = ground_of(terrain, layout=layout).build()
    drawn = continued(tile)
    assert (drawn is not tile) == goes_on
    if goes_on:
        model, data = (robot := SimulatedRobot(CONFIG, drawn)).model, robot.data
        on_the_way, far_beside = (
            mujoco.mj_ray(model, data, np.array([2.6, y, 20.0]), np.array([0.0, 0.0, -1.0]), None, 1, -1, None)
            for y in (1.5, 150.0)
        )
        assert on_the_way != pytest.approx(20.0)
        assert far_beside == pytest.approx(on_the_way)


def test_an_unknown_robot_is_named():
    with pytest.raises(ArriveError, match="anymal_c"):
        SimulatedRobot(dataclasses.replace(CONFIG, robot="spot"), FLAT)


def test_the_model_can_be_drawn_right_after_a_reset():
    robot = SimulatedRobot(CONFIG, FLAT)
    robot.reset((2.0, 1.0))
    body = mujoco.mj_name2id(robot.model, mujoco.mjtObj.mjOBJ_BODY, robot.robot.base_body)
    np.testing.assert_allclose(robot.data.xpos[body], robot.base_pos_w)
