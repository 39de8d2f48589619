"""Export and the controller: the same actions as in training, and nothing unsafe whatever it is told."""

import dataclasses
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper
from tensordict import TensorDict

import arrive.deployment
from arrive.build import Placement, build_env
from arrive.cli import main
from arrive.config import Config, override
from arrive.deployment import (
    Controller,
    ControlLog,
    GridHeights,
    HeightMap,
    Joystick,
    PointCloud,
    Safety,
    Sensors,
    Target,
    WayPoints,
    replay,
)
from arrive.deployment.export import export_policy
from arrive.deployment.faults import BadInput
from arrive.deployment.goals import Navigator
from arrive.deployment.heights import HeightGrid
from arrive.deployment.inputs import frame_of
from arrive.deployment.onnx_file import PREFIX, SEAL, seal
from arrive.deployment.policy_file import read_policy_file
from arrive.deployment.specs import GridSpec, TaskSpec
from arrive.deployment.terms import COMPUTED
from arrive.deployment.verify import verify
from arrive.env import POLICY
from arrive.errors import ArriveError
from arrive.learning.policy import load_policy
from arrive.learning.ppo import make_actor
from arrive.learning.rundir import write_config
from arrive.learning.symmetry import make_reflections
from arrive.learning.trainer import Trainer
from arrive.presets import get_preset
from arrive.task.registry import get_task
from arrive.terrain import FAMILIES
from arrive.terrain.tile import RASTER_CELL, RASTER_HALF

DT = 0.02
AHEAD = Joystick(1.0, 0.0)
CONFIG = override(
    get_preset("robust"),
    (
        "num_envs=2",
        "ppo.num_steps=2",
        "terrain.levels=1",
        "terrain.variants=1",
        "observation.noise=false",
        "randomisation.push_speed=0",
    ),
)
TASK = TaskSpec("final", 2.0, 6.0, 0.5, [1.0, 5.0], 0.5)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a run whose untrained networks are made to act as strongly as trained ones."""
    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("run")
    write_config(folder, CONFIG)
    trainer = Trainer(CONFIG, build_env(CONFIG, threads=1), folder)
    with torch.no_grad():
        trainer.algorithm.get_policy().mlp[-1].weight.mul_(3.0)
    trainer.save()
    return folder


@pytest.fixture(scope="module")
def exported(run):
    """The file that the command line makes of it."""
    main(["export", str(run), "-o", str(run / "robot.onnx")])
    return run / "robot.onnx"


@pytest.fixture
def controller(exported):
    return Controller.load(exported)


def an_env(family: str):
    """Robots on the family's hardest level, without noise and pushes."""
    terrain = dataclasses.replace(CONFIG.terrain, families=(family,))
    config: Config = dataclasses.replace(CONFIG, num_envs=4, terrain=terrain)
    assignment = (torch.zeros(4, dtype=torch.long), torch.zeros(4, dtype=torch.long))
    return build_env(config, Placement(values=((FAMILIES[family].highest,),), assignment=assignment), threads=1)


def sensors_of(state, i: int, time_s: float) -> Sensors:
    """What robot i would measure."""
    names = ("joint_pos", "joint_vel", "base_pos_w", "base_quat_w", "base_lin_vel_b", "base_ang_vel_b")
    return Sensors(**{name: getattr(state, name)[i].numpy() for name in names}, time_s=time_s)


def standing(controller: Controller, now: float, **changes) -> Sensors:
    """The measurements of a robot that stands at the origin and looks along x."""
    values = {
        "joint_pos": np.array(controller.policy.robot.default_joint_pos_rad),
        "joint_vel": np.zeros(12),
        "base_pos_w": np.array([0.0, 0.0, 0.5]),
        "base_quat_w": np.array([1.0, 0.0, 0.0, 0.0]),
        "base_lin_vel_b": np.zeros(3),
        "base_ang_vel_b": np.zeros(3),
        "time_s": now,
    }
    return Sensors(**values | changes)


def flat(time_s: float) -> GridHeights:
    return GridHeights(np.zeros(187), time_s)


def step(controller: Controller, now: float, goal=AHEAD, terrain=None, **changes):
    """One step of a standing robot; what it returns is checked against what no command may leave."""
    command = controller.step(standing(controller, now, **changes), goal, terrain or flat(now), now)
    assert_safe(controller, command)
    return command


def assert_safe(controller, command):
    low, high = np.array(controller.policy.robot.joint_limits_rad).T
    assert command.targets.shape == (12,)
    assert np.isfinite(command.targets).all()
    assert (command.targets >= low).all()
    assert (command.targets <= high).all()


# The same as in training.


def test_exported_actions_are_the_training_policys(run, exported):
    policy, file = load_policy(run), read_policy_file(exported)
    env = an_env("pit")
    observation, recorded = env.get_observations()[POLICY], []
    for _ in range(75):
        recorded.append(observation)
        observation = env.step(policy.act(observation))[0][POLICY]
    random = 2.0 * torch.randn(10_000, observation.shape[1], generator=torch.Generator().manual_seed(1))
    inputs = torch.cat([random, *recorded])
    assert len(inputs) == 10_300
    trained = policy.act(inputs).numpy()
    assert np.abs(trained).max() > 0.5
    np.testing.assert_allclose(file.act(inputs.numpy()), trained, atol=1e-5, rtol=0)


@pytest.mark.parametrize("family", ["flat", "pit"])
def test_controller_sees_and_does_what_the_environment_does(family, run, exported):
    env, policy = an_env(family), load_policy(run)
    controllers = [Controller.load(exported) for _ in range(env.num_envs)]
    observation, compared = env.get_observations()[POLICY], 0
    for step_number in range(100):
        now, state, command = DT * step_number, env.state, env.task.command
        actions = policy.act(observation)
        for i, controller in enumerate(controllers):
            if env.episode_length_buf[i] == 0:
                controller.reset()
            # The environment counts down to 0 and has targets farther away, the controller stops at its limits.
            goal = Target(command.target_w[i].tolist(), now + float(command.time_left_s[i]))
            sensors, heights = sensors_of(state, i, now), GridHeights(state.heights_w[i].numpy(), now)
            frame = frame_of(sensors, goal, heights, now, controller._grid)
            seen, _ = controller.observe(frame)
            mine = observation[i].numpy()
            if float(command.time_left_s[i]) > 2.0 and np.linalg.norm(mine[9:12]) * 2.0 < 5.0:
                np.testing.assert_allclose(seen, mine, atol=1e-5, rtol=0)
                compared += 1
                controller.step(sensors, goal, heights, now)
                np.testing.assert_allclose(controller._action, actions[i], atol=1e-4, rtol=0)
            controller._action = actions[i].double().numpy()
            controller._last_now_s = now
        observation = env.step(actions)[0][POLICY]
    assert compared > 300


def test_targets_are_the_default_pose_plus_scaled_action_within_the_torque_limit(controller):
    command = step(controller, 0.0)
    robot = controller.policy.robot
    asked = np.array(robot.default_joint_pos_rad) + 0.5 * controller._action
    np.testing.assert_allclose(command.targets, asked, atol=1e-9)
    # At 20 rad/s damping alone is 40 N m, so 40 N m are left for the spring against the motion: 0.5 rad.
    controller.reset()
    speed = np.full(12, 20.0)
    pos = np.array(robot.default_joint_pos_rad) + 3.0 * np.array([0, 1, 1] * 4)
    command = step(controller, DT, joint_pos=pos, joint_vel=speed)
    assert command.mode == "joystick"
    pitch = np.array([False, True, True] * 4)
    torque = 80.0 * (command.targets - pos) - 2.0 * speed
    assert (np.abs(torque[pitch]) <= 80.0 + 1e-9).all()
    np.testing.assert_allclose(command.targets[pitch], (pos - 0.5)[pitch], atol=1e-9)


# What the policy is told.


def order(goal, pos=(0.0, 0.0, 0.5), yaw=0.0, ground=0.0, now=0.0, task=TASK, navigator=None):
    return (navigator or Navigator(task)).order(goal, np.array(pos), yaw, ground, now)


def test_target_counts_down_then_holds():
    goal = Target((3.0, 0.0, 0.5), 5.0)
    assert order(goal).time_left_s == 5.0
    assert order(goal, now=2.5).time_left_s == 2.5
    # Half a second is the least the policy is told; when time is over, the reward window.
    assert order(goal, now=4.4).time_left_s == pytest.approx(0.6)
    assert order(goal, now=4.9)[1:] == (0.5, "target", "")
    assert order(goal, now=60.0)[1:] == (2.0, "hold", "time is over")
    assert order(goal, now=-10.0).time_left_s == 6.0


def test_far_target_is_pulled_near_at_the_same_pace():
    result = order(Target((20.0, 0.0, 0.5), 12.0))
    np.testing.assert_allclose(result.target_w, (5.0, 0.0, 0.5))
    assert result.time_left_s == 3.0
    assert "20 m away" in result.reason


@pytest.mark.parametrize(
    ("stick", "yaw", "target", "time_left"),
    [
        ((1.0, 0.0), 0.0, (4.0, 2.0), 2.0),
        ((0.0, 1.0), 0.0, (1.0, 5.0), 2.0),
        ((-3.0, 0.0), 0.0, (-2.0, 2.0), 2.0),
        ((1.0, 0.0), math.pi / 2, (1.0, 5.0), 2.0),
        # Forward means the world's y axis.
        ((1.0, 0.0, math.pi / 2), 2.5, (1.0, 5.0), 2.0),
        # Half way between dead zone and full: half way between 3 m in 4.5 s and 1.5 m/s.
        ((0.55, 0.0), 0.0, (4.0, 2.0), 3.0 / ((2.0 / 3.0 + 1.5) / 2.0)),
        ((0.1, 0.0), 0.0, (4.0, 2.0), 4.5),
    ],
)
def test_joystick_puts_the_target_3_m_away_and_scales_time(stick, yaw, target, time_left):
    result = order(Joystick(*stick), pos=(1.0, 2.0, 0.4), yaw=yaw, ground=-0.3)
    np.testing.assert_allclose(result.target_w, (*target, 0.2), atol=1e-12)
    assert result.time_left_s == pytest.approx(time_left)
    assert result.mode == "joystick"


def test_a_reversed_stick_turns_the_pseudo_velocity_at_2_m_per_s2():
    navigator = Navigator(TASK)

    def asked(stick: float, now_s: float) -> tuple[float, float]:
        """Distance along x and remaining time."""
        given = navigator.order(Joystick(stick, 0.0), np.zeros(3), 0.0, 0.0, now_s)
        return given.target_w[0], given.time_left_s

    assert asked(1.0, 10.0) == pytest.approx((3.0, 2.0))  # from standing at once
    assert asked(-1.0, 10.1) == pytest.approx((3.0, 3.0 / 1.3))
    # Slower than 3 m in 4.5 s the target comes nearer instead.
    assert asked(-1.0, 10.5) == pytest.approx((0.5 * 4.5, 4.5))
    assert asked(-1.0, 10.75) == pytest.approx((0.0, 4.5))
    assert asked(-1.0, 11.5) == pytest.approx((-3.0, 2.0))
    # A stop holds a place at once, and the next stick begins from the speed that was left.
    stop = navigator.order(Joystick(0.0, 0.0), np.zeros(3), 0.0, 0.0, 11.75)
    assert (stop.mode, stop.target_w[0]) == ("stop", pytest.approx(-0.75))
    assert asked(-1.0, 11.76) == pytest.approx((-3.0, 3.0 / 1.02))
    # Another kind of goal forgets.
    navigator.order(Target((1.0, 0.0, 0.5), 14.0), np.zeros(3), 0.0, 0.0, 11.78)
    assert asked(1.0, 11.8) == pytest.approx((3.0, 2.0))


def test_joystick_scales_the_distance_of_a_continuous_policy():
    task = dataclasses.replace(TASK, name="continuous", reward_window_s=6.0)
    for magnitude in (0.2, 1.0):
        result = order(Joystick(magnitude, 0.0), task=task)
        np.testing.assert_allclose(result.target_w, (3.0 * magnitude, 0.0, 0.5))
        assert result.time_left_s == 3.0


def test_released_stick_stops_half_a_second_ahead():
    navigator = Navigator(TASK)
    order(Joystick(0.0, 1.0), navigator=navigator)
    for x in (1.0, 1.4):
        result = order(Joystick(0.05, 0.0), pos=(x, 0.2, 0.5), navigator=navigator)
        # Full stick is 1.5 m/s.
        np.testing.assert_allclose(result.target_w, (1.0, 0.2 + 0.75, 0.5))
        assert (result.mode, result.time_left_s) == ("stop", 2.0)


def test_stick_that_was_never_pulled_holds_the_place():
    np.testing.assert_allclose(order(Joystick(0.0, 0.0), pos=(1.0, 0.2, 0.5)).target_w, (1.0, 0.2, 0.5))


def test_way_points_are_passed_without_a_stop():
    path, navigator = WayPoints(((2.0, 0.0, 0.5), (2.0, 2.0, 0.7)), speed=1.0, radius=0.5), Navigator(TASK)
    for x in (0.0, 1.4):
        result = order(path, pos=(x, 0.0, 0.5), navigator=navigator)
        np.testing.assert_allclose(result.target_w, (x + 3.0, 0.0, 0.5))
        assert (result.time_left_s, result.reason) == (3.0, "1 of 2")
    result = order(path, pos=(1.6, 0.0, 0.7), now=2.0, navigator=navigator)
    np.testing.assert_allclose(result.target_w, (2.0, 2.0, 0.7))
    assert result.time_left_s == pytest.approx(math.hypot(0.4, 2.0))
    # The first point does not count again, and the last is held.
    result = order(path, pos=(0.0, 0.0, 0.7), now=9.0, navigator=navigator)
    np.testing.assert_allclose(result.target_w, (2.0, 2.0, 0.7))
    assert (result.mode, result.time_left_s) == ("hold", 2.0)


# Heights.


def small_grid() -> HeightGrid:
    """Five by five points, 0.1 m apart."""
    points = [[x / 10, y / 10] for x in range(-2, 3) for y in range(-2, 3)]
    return HeightGrid(GridSpec(points, 0.1, 0.5, 1.0))


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
    heights = np.zeros(187)
    heights[::3] = np.nan
    assert step(controller, 0.0, terrain=GridHeights(heights, 0.0)).mode == "joystick"
    heights[:50] = np.nan
    command = step(controller, DT, terrain=GridHeights(heights, DT))
    assert command.mode == "joystick"
    assert "of the ground seen" in command.reason
    command = step(controller, 2 * DT, terrain=GridHeights(np.full(187, np.nan), 2 * DT))
    assert (command.mode, command.reason) == ("safe", "only 0% of the ground was seen")


# Whatever it is told.

BAD_SENSORS = {
    "NaN joint": {"joint_pos": np.full(12, np.nan)},
    "infinite speed": {"joint_vel": np.full(12, np.inf)},
    "huge speed": {"joint_vel": np.full(12, 1e300)},
    "eleven joints": {"joint_pos": np.zeros(11)},
    "no joints": {"joint_pos": None},
    "text": {"base_lin_vel_b": "fast"},
    "matrix": {"base_pos_w": np.zeros((3, 3))},
    "NaN position": {"base_pos_w": np.array([0.0, np.nan, 0.5])},
    "no rotation": {"base_quat_w": np.zeros(4)},
    "old": {"time_s": -1.0},
    "from the future": {"time_s": 99.0},
    "no time": {"time_s": float("nan")},
}
BAD_GOALS = {
    "none": None,
    "text": "home",
    "NaN target": Target((0.0, math.nan, 0.5), 5.0),
    "infinite deadline": Target((1.0, 0.0, 0.5), math.inf),
    "flat target": Target((1.0, 0.0), 5.0),
    "NaN stick": Joystick(math.nan, 0.0),
    "NaN heading": Joystick(1.0, 0.0, math.nan),
    "no stick": Joystick(None, 0.0),
    "no way-points": WayPoints(()),
    "no points": WayPoints(3),
    "half a way-point": WayPoints(((1.0, 0.0),)),
    "backwards": WayPoints(((1.0, 0.0, 0.5),), speed=-1.0),
}
BAD_TERRAINS = {
    "few": GridHeights(np.zeros(10), 1.0),
    "infinite": GridHeights(np.full(187, np.inf), 1.0),
    "old": GridHeights(np.zeros(187), -5.0),
    "text": GridHeights("flat", 1.0),
    "none": "flat",
    "no cell": HeightMap((0, 0), 0.0, np.zeros((3, 3)), 1.0),
    "empty map": HeightMap((0, 0), 0.1, np.zeros((0, 0)), 1.0),
    "map of holes": HeightMap((-2, -2), 0.1, np.full((40, 40), np.nan), 1.0),
    "infinite map": HeightMap((-2, -2), 0.1, np.full((40, 40), np.inf), 1.0),
    "map elsewhere": HeightMap((1e300, 0), 1e-300, np.zeros((3, 3)), 1.0),
    "empty cloud": PointCloud(np.zeros((0, 3)), 1.0),
    "flat cloud": PointCloud(np.zeros((5, 2)), 1.0),
    "infinite cloud": PointCloud(np.full((5, 3), np.inf), 1.0),
}


@pytest.mark.parametrize("walking", [True, False], ids=["walking", "first"])
@pytest.mark.parametrize(
    "bad",
    [{"sensors": x} for x in BAD_SENSORS.values()]
    + [{"goal": x} for x in BAD_GOALS.values()]
    + [{"terrain": x} for x in BAD_TERRAINS.values()],
    ids=[*BAD_SENSORS, *BAD_GOALS, *BAD_TERRAINS],
)
def test_bad_input_means_the_safe_stance(controller, bad, walking):
    pose = np.array(controller.policy.robot.default_joint_pos_rad) + 0.1
    if walking:
        step(controller, 1.0 - DT, joint_pos=pose)
    sensors = {"joint_pos": pose} | bad.get("sensors", {})
    command = step(controller, 1.0, bad.get("goal", Joystick(1.0, 0.0)), bad.get("terrain"), **sensors)
    assert command.mode == "safe"
    assert command.reason
    # Where the joints are, as far as that is known.
    if walking or "sensors" not in bad:
        measured = pose if "joint_vel" not in bad.get("sensors", {}) else command.targets
        np.testing.assert_allclose(command.targets, measured)


@pytest.mark.parametrize("now", [float("nan"), float("inf"), -1.0, None])
def test_bad_clock_means_the_safe_stance(controller, now):
    step(controller, 1.0)
    command = controller.step(standing(controller, 1.0), Joystick(1.0, 0.0), flat(1.0), now)
    assert command.mode == "safe"
    assert_safe(controller, command)


def test_target_out_of_range_stays_within_limits(controller):
    for i, x in enumerate((1e2, 1e9, 1e200, -1e308)):
        step(controller, i * DT, Target((x, -x, x), 5.0))


def test_random_states_never_give_an_unsafe_target(controller):
    rng = np.random.default_rng(0)
    for i in range(300):
        scale = 10.0 ** rng.uniform(-1, 6)
        changes = {name: scale * rng.normal(size=12) for name in ("joint_pos", "joint_vel")}
        changes["base_quat_w"] = (quat := rng.normal(size=4)) / np.linalg.norm(quat)
        changes |= {name: scale * rng.normal(size=3) for name in ("base_pos_w", "base_lin_vel_b", "base_ang_vel_b")}
        step(controller, i * DT, terrain=GridHeights(scale * rng.normal(size=187), i * DT), **changes)


def test_safe_stance_glides_to_the_default_pose_and_recovers_after_half_a_second(controller):
    default = np.array(controller.policy.robot.default_joint_pos_rad)
    start = default + 0.2 * np.array([1.0, -1.0, 0.01] * 4)
    step(controller, 0.0, joint_pos=start)
    np.testing.assert_allclose(step(controller, 0.02, goal=None, joint_pos=start).targets, start)
    # 0.5 rad/s for 0.02 s.
    one = step(controller, 0.04, goal=None, joint_pos=start).targets - default
    np.testing.assert_allclose(one, [0.19, -0.19, 0.0] * 4, atol=1e-9)
    modes, now = [], 0.04
    for _ in range(40):
        now += DT
        command = step(controller, now, joint_pos=start)
        modes.append(command.mode)
    assert modes == ["safe"] * 25 + ["joystick"] * 15
    # A fault in between starts the half second again.
    step(controller, now + DT, goal=None)
    for i in range(2, 12):
        step(controller, now + i * DT)
    step(controller, now + 12 * DT, goal=None)
    later = [step(controller, now + i * DT).mode for i in range(13, 40)]
    assert later == ["safe"] * 25 + ["joystick"] * 2


def test_safe_stance_keeps_a_standing_robot_up(controller):
    env = an_env("flat")
    default = torch.tensor(controller.policy.robot.default_joint_pos_rad)
    for _ in range(50):
        env.step(torch.zeros(4, 12))
    assert env.episode_length_buf[0] == 50
    for i in range(100):
        command = controller.step(sensors_of(env.state, 0, i * DT), None, flat(i * DT), i * DT)
        action = (torch.from_numpy(command.targets).float() - default) / 0.5
        env.step(action.repeat(4, 1))
        assert env.state.crash_contacts[0] == 0
    assert env.state.base_pos_w[0, 2] > 0.4
    np.testing.assert_allclose(command.targets, default, atol=1e-6)


# Inputs that cannot be true.


class Trot:
    """Inputs of a robot that trots along x, by number of the step."""

    def __init__(self, controller: Controller):
        self.robot = controller.policy.robot
        self.default = np.array(self.robot.default_joint_pos_rad)

    def at(self, i: int) -> dict:
        phase = 2.0 * math.pi * 1.5 * i * DT + np.arange(12)
        return {
            "joint_pos": self.default + 0.3 * np.sin(phase),
            "joint_vel": 0.3 * 2.0 * math.pi * 1.5 * np.cos(phase),
            "base_pos_w": np.array([0.5 * i * DT, 0.0, 0.55]),
            "base_quat_w": np.array([1.0, 0.0, 0.0, 0.0]),
            "base_lin_vel_b": np.array([0.5, 0.0, 0.0]),
            "base_ang_vel_b": np.zeros(3),
            "heights": np.zeros(187),
            "sensors_time": i * DT,
            "terrain_time": i * DT,
            "now": i * DT,
        }


def act_on(controller: Controller, inputs: dict, goal):
    """One step; what it returns is safe."""
    sensors = Sensors(**{f: inputs[f] for f in SPIKED[:6]}, time_s=inputs["sensors_time"])
    command = controller.step(sensors, goal, GridHeights(inputs["heights"], inputs["terrain_time"]), inputs["now"])
    assert_safe(controller, command)
    return command


SPIKED = ("joint_pos", "joint_vel", "base_pos_w", "base_quat_w", "base_lin_vel_b", "base_ang_vel_b", "heights",
          "sensors_time", "terrain_time", "now")  # fmt: skip


def spike(rng: np.random.Generator, inputs: dict) -> str:
    """Put one finite number, of any size, in the place of one or all of an input's."""
    name = SPIKED[rng.integers(len(SPIKED))]
    size = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-1.0, 6.0 if rng.random() < 0.8 else 300.0)
    if np.isscalar(inputs[name]):
        inputs[name] = inputs[name] + size
    else:
        inputs[name] = inputs[name].copy()
        inputs[name][slice(None) if rng.random() < 0.3 else rng.integers(len(inputs[name]))] += size
    return f"{name} {size:g}"


SPIKED_GOALS = {"go": AHEAD, "stop": Joystick(0.0, 0.0), "target": Target((3.0, 1.0, 0.5), 4.0)}


@pytest.mark.parametrize("goal", SPIKED_GOALS.values(), ids=SPIKED_GOALS)
@pytest.mark.parametrize(("recover_s", "count"), [(0.1, 324), (0.5, 10)])
def test_a_spike_is_forgotten_within_the_stated_time(exported, goal, recover_s, count):
    """Single spikes of finite numbers, 1,002 in all; the stated time is `recover_s` and two steps."""
    controller = Controller.load(exported, Safety(recover_s=recover_s))
    rng, trot, refused = np.random.default_rng(7), Trot(controller), 0
    steps = round(recover_s / DT) + 2
    for _ in range(count):
        controller.reset()
        for i in range(2):
            calm = act_on(controller, trot.at(i), goal)
        inputs = trot.at(2)
        what = spike(rng, inputs)
        refused += act_on(controller, inputs, goal).mode == "safe"
        modes = [act_on(controller, trot.at(3 + k), goal).mode for k in range(steps + 3)]
        assert modes[steps:] == [calm.mode] * 3, (what, modes)
    assert 0.4 * count < refused < count


def test_after_a_spike_the_policy_is_told_the_pose_that_was_held(controller, monkeypatch):
    """Without that, an action once implausible stays so, and the robot in the safe stance."""
    observe, seen = Controller.observe, []

    def spy(controller, frame):
        observation, order = observe(controller, frame)
        seen.append(observation[37:49])
        return observation, order

    monkeypatch.setattr(Controller, "observe", spy)
    trot = Trot(controller)
    act_on(controller, trot.at(0), AHEAD)
    act_on(controller, trot.at(1) | {"joint_vel": np.full(12, 2000.0)}, AHEAD)
    for i in range(2, 10):
        held = act_on(controller, trot.at(i), AHEAD)
        np.testing.assert_allclose(controller.policy.robot.action_scale_rad * controller._action + trot.default,
                                   controller._held)  # fmt: skip
    assert held.mode == "safe"
    np.testing.assert_allclose(seen[-1], (controller._held - trot.default) / 0.5, atol=0.03)


def test_a_stop_is_not_anchored_where_a_spike_was(controller):
    trot = Trot(controller)
    act_on(controller, trot.at(0), AHEAD)
    act_on(controller, trot.at(1) | {"base_pos_w": np.array([900.0, 0.0, 0.55])}, Joystick(0.0, 0.0))
    for i in range(2, 40):
        command = act_on(controller, trot.at(i), Joystick(0.0, 0.0))
    assert command.mode == "stop"
    assert abs(controller._navigator._anchor[0]) < 1.0


def test_a_missing_goal_does_not_begin_the_way_points_again():
    path, navigator = WayPoints(((1.0, 0.0, 0.5), (3.0, 0.0, 0.5))), Navigator(TASK)
    order(path, pos=(0.9, 0.0, 0.5), navigator=navigator)
    with pytest.raises(BadInput, match="no goal"):
        order(None, pos=(2.0, 0.0, 0.5), navigator=navigator)
    assert order(path, pos=(2.0, 0.0, 0.5), navigator=navigator).target_w[0] == 3.0


IMPOSSIBLE = {
    "on its back": ({"base_quat_w": np.array([0.0, 1.0, 0.0, 0.0])}, "fallen", "tilted by 3.14 rad"),
    "on its side": ({"base_quat_w": np.array([math.cos(0.7), math.sin(0.7), 0.0, 0.0])}, "fallen", "tilted by 1.40"),
    "degrees": ({"joint_pos": np.degrees([0, 0.4, -0.8] * 4)}, "safe", "in degrees"),
    "far outside": ({"joint_pos": np.full(12, 50.0)}, "safe", "joint_pos of LF_HAA is 50 rad, 49.5 rad outside"),
    "degrees per second": ({"joint_vel": np.full(12, 115.0)}, "safe", "joint_vel reaches 115 rad/s, more than 75"),
    "turning in degrees": ({"base_ang_vel_b": np.array([0, 0, 57.3])}, "safe", "base_ang_vel_b reaches 57.3"),
    "millimetres": ({"base_lin_vel_b": np.array([800.0, 0, 0])}, "safe", "base_lin_vel_b reaches 800 m/s"),
    "height in another frame": ({"base_pos_w": np.array([0, 0, 550.0])}, "safe", "in one frame"),
}


@pytest.mark.parametrize(("changes", "mode", "reason"), IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_what_cannot_be_is_refused_and_the_way_back_is_half_a_second(controller, changes, mode, reason):
    for i in range(10):
        command = step(controller, i * DT, **changes)
        assert command.mode == mode
        assert reason in command.reason
    modes = [step(controller, (10 + i) * DT).mode for i in range(30)]
    assert modes[:20] == ["safe"] * 20
    assert modes[-1] == "joystick"


def test_a_fallen_robot_is_not_moved(controller):
    """Legs that glide to the default pose would throw it about."""
    rng, default = np.random.default_rng(0), np.array(controller.policy.robot.default_joint_pos_rad)
    for i in range(50):
        pose = default + 0.3 * np.sin(0.1 * i) * rng.uniform(0.5, 1.0, 12)
        command = step(controller, i * DT, base_quat_w=np.array([0.0, 0.0, 1.0, 0.0]), joint_pos=pose)
        np.testing.assert_allclose(
            command.targets, np.clip(pose, *np.array(controller.policy.robot.joint_limits_rad).T)
        )


def test_a_clock_that_counts_milliseconds_is_noticed(controller):
    step(controller, 0.0)
    for i in range(1, 10):
        command = step(controller, 20.0 * i)
        assert (command.mode, "is it in seconds?" in command.reason) == ("safe", True)


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 0.0, None, "1", True])
def test_a_safety_that_is_no_limit_is_refused(value):
    with pytest.raises(ArriveError, match=r"Safety\.recover_s must be a finite number above 0"):
        Safety(recover_s=value)


def test_a_policy_may_walk_at_any_tilt_below_the_stated_one(controller):
    for i in range(5):
        assert step(controller, i * DT, base_quat_w=np.array([math.cos(0.6), 0, math.sin(0.6), 0])).mode == "joystick"


@pytest.mark.parametrize("tick", [0.0, 1e-5])
def test_a_clock_that_stands_still_is_noticed(controller, tick):
    step(controller, 1.0)
    commands = [step(controller, 1.0 + tick * i) for i in range(1, 500)]
    assert [command.mode for command in commands[:4]] == ["joystick"] * 4
    assert {command.mode for command in commands[4:]} == {"safe"}
    assert "the clock stands still at 1" in commands[-1].reason
    assert [step(controller, 2.0 + i * DT).mode for i in range(30)][-1] == "joystick"


@pytest.mark.parametrize("stamp", ["sensors", "heights"])
def test_stamps_that_stand_still_are_noticed(controller, stamp):
    for i in range(60):
        now = 1.0 + i * DT
        changes = {"time_s": 1.0} if stamp == "sensors" else {"terrain": flat(1.0)}
        command = step(controller, now, **changes)
        limit = 0.1 if stamp == "sensors" else 1.0
        assert (command.mode == "safe") == (now - 1.0 > limit)
    assert f"{stamp} are 1.18 s old" in command.reason


class Raises:
    """Whatever is read from it, even its class, raises."""

    def __getattribute__(self, name):
        raise RuntimeError(name)


class Late(Target):
    """A goal whose deadline raises once it has been made."""

    @property
    def arrive_at_s(self):
        raise RuntimeError("late")

    @arrive_at_s.setter
    def arrive_at_s(self, value):
        pass


class Broken(HeightMap):
    @property
    def heights_w(self):
        raise OSError("the map's memory is gone")

    @heights_w.setter
    def heights_w(self, value):
        pass


def test_objects_that_raise_mean_the_safe_stance(controller):
    late, broken, empty = object.__new__(Late), object.__new__(Broken), object.__new__(Target)
    good = standing(controller, 0.0), AHEAD, flat(0.0), 0.0
    for place, value in (
        (0, Raises()),
        (1, Raises()),
        (1, late),
        (1, empty),
        (2, Raises()),
        (2, broken),
        (3, Raises()),
    ):
        controller.reset()
        command = controller.step(*good[:place], value, *good[place + 1 :])
        assert command.mode == "safe", (place, value)
        assert command.reason
        assert_safe(controller, command)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (
            lambda s, g, t: (g, s, t),
            "the argument sensors is a Joystick, which belongs to goal: call step(sensors,",
        ),
        (lambda s, g, t: (s, t, g), "the argument goal is a GridHeights, which belongs to terrain"),
        (lambda s, g, t: (t, g, s), "the argument sensors is a GridHeights"),
        (lambda s, g, t: (s, Target(5.0, (1.0, 0.0, 0.5)), t), "is the order position_w, arrive_at_s?"),
        (
            lambda s, g, t: (s, g, HeightMap(np.zeros((9, 9)), 0.1, (0, 0), 0.0)),
            "origin_w is of shape (9, 9), not",
        ),
        (lambda s, g, t: (s, g, HeightMap(0.1, (0, 0), np.zeros((9, 9)), 0.0)), "Are arguments swapped?"),
        (lambda s, g, t: (s, g, HeightMap((0, 0), -1.0, np.zeros((9, 9)), 0.0)), "resolution_m above 0, not -1"),
        (lambda s, g, t: (s, g, PointCloud(np.zeros((3, 9)), 0.0)), "points_w is of shape (3, 9), not (n, 3)"),
        (lambda s, g, t: (s, g, GridHeights(0.0, np.zeros(187))), "heights_w is of shape (), not 1 dimension"),
    ],
)
def test_swapped_arguments_are_said(controller, arguments, reason):
    command = controller.step(*arguments(standing(controller, 0.0), AHEAD, flat(0.0)), 0.0)
    assert command.mode == "safe"
    assert reason in command.reason


def test_the_table_of_terms_is_that_of_training(controller):
    schema = an_env("flat").observer.schema()
    assert [row["name"] for row in schema] == list(COMPUTED)
    for row, known in zip(schema, COMPUTED.values(), strict=True):
        assert row["stop"] - row["start"] == known.size(controller.policy)


def test_nothing_in_deployment_imports_in_a_circle():
    """Not in functions and not for types either."""
    folder = Path(arrive.deployment.__file__).parent
    imports = {
        path.stem: set(re.findall(r"from arrive\.deployment\.(\w+) import", path.read_text()))
        for path in folder.glob("*.py")
        if path.stem != "__init__"
    }
    assert imports["controller"]
    done: set[str] = set()
    while len(done) < len(imports):
        free = {name for name, needs in imports.items() if name not in done and needs <= done}
        assert free, {name: needs - done for name, needs in imports.items() if name not in done}
        done |= free


# Files.


SEAL_SIZE = len(seal(b""))


def changed(exported, folder, change, sealed=False):
    """A copy of the exported file with something changed; `sealed` gives it a checksum that agrees."""
    content = exported.read_bytes()
    model = onnx.load_from_string(content)
    text = {entry.key: entry.value for entry in model.metadata_props if entry.key != PREFIX + SEAL}
    change(model, text)
    onnx.helper.set_model_props(model, text)
    body = model.SerializeToString()
    (folder / "changed.onnx").write_bytes(seal(body) if sealed else body + content[-SEAL_SIZE:])
    return folder / "changed.onnx"


def edit(section, change):
    def apply(model, text):
        value = json.loads(text[PREFIX + section])
        change(value)
        text[PREFIX + section] = json.dumps(value)

    return apply


def flip(index):
    """Turn the sign of one weight of the first layer."""

    def apply(model, text):
        weights = numpy_helper.to_array(first_layer(model)).copy()
        weights[0, index] *= -1
        first_layer(model).CopyFrom(numpy_helper.from_array(weights, "w0"))

    return apply


def swap_slices(terms):
    terms[0]["name"], terms[1]["name"] = terms[1]["name"], terms[0]["name"]


def test_exported_file_explains_itself(exported, capsys):
    file = verify(exported)
    assert file.terms[3].name == "target"
    assert (file.terms[3].start, file.terms[3].stop, file.terms[3].unit, file.terms[3].frame) == (9, 12, "m", "base")
    assert file.robot.joint_names[:3] == ["LF_HAA", "LF_HFE", "LF_KFE"]
    assert file.robot.joint_limits_rad[0] == [-0.72, 0.49]
    assert len(file.meta["golden"]["actions"]) == 16
    assert file.meta["evaluation"] is None
    main(["verify", str(exported)])
    assert "16 golden pairs reproduced" in capsys.readouterr().out


def test_evaluation_summary_travels_along(run, tmp_path):
    summary = {"families": {"flat": {}}, "protocol": {"episodes": 5}, "commit": "abc"}
    (tmp_path / "difficulty.json").write_text(json.dumps(summary | {"policy": {}}))
    (tmp_path / "policy.pt").write_bytes((run / "policy.pt").read_bytes())
    export_policy(load_policy(tmp_path), tmp_path / "policy.onnx")
    assert read_policy_file(tmp_path / "policy.onnx").meta["evaluation"] == summary


@pytest.mark.parametrize(
    ("change", "sealed", "message"),
    [
        (flip(0), False, "was changed after the export"),
        (flip(0), True, "does not reproduce its golden pairs"),
        (edit("observation", swap_slices), False, "was changed after the export"),
        (edit("observation", swap_slices), True, r"observation\[0\]"),
        (edit("observation", lambda terms: terms[4].update(scale=1.0)), True, r"observation\[4\].scale"),
        (edit("observation", lambda terms: terms[4].update(stop=14)), True, "slice"),
        (edit("observation", lambda terms: terms.pop()), True, "has 236 observations"),
        (edit("robot", lambda robot: robot.update(stiffness=90.0)), True, r"robot.stiffness is 90.0 there, 80.0 here"),
        (edit("robot", lambda robot: robot["joint_names"].reverse()), True, r"robot.joint_names\[0\]"),
        (edit("robot", lambda robot: robot.pop("damping")), True, "damaged"),
        (edit("control", lambda control: control.update(period_s=0.01)), True, "control.period_s"),
        (edit("golden", lambda golden: golden["actions"][0].__setitem__(0, 9.0)), True, "golden actions differ"),
        (lambda model, text: text.pop(PREFIX + "task"), True, "lacks the metadata task"),
        (lambda model, text: text.update({PREFIX + "format": "99"}), True, "export format 99"),
        (lambda model, text: text.clear(), True, "no policy of arrive"),
    ],
)
def test_verify_refuses_what_was_changed(exported, tmp_path, change, sealed, message):
    with pytest.raises(ArriveError, match=message):
        verify(changed(exported, tmp_path, change, sealed))


def test_every_weight_counts_even_one_too_small_for_the_golden_pairs(exported, tmp_path):
    def nudge(model, text):
        weights = numpy_helper.to_array(first_layer(model)).copy()
        weights[0, 0] = np.nextafter(weights[0, 0], np.float32(9))
        first_layer(model).CopyFrom(numpy_helper.from_array(weights, "w0"))

    with pytest.raises(ArriveError, match="was changed after the export"):
        verify(changed(exported, tmp_path, nudge))


@pytest.mark.parametrize("content", [b"", b"hello", None], ids=["empty", "foreign", "truncated"])
def test_corrupt_files_are_refused_in_one_line(exported, tmp_path, content, capsys):
    path = tmp_path / "bad.onnx"
    path.write_bytes(exported.read_bytes()[:5000] if content is None else content)
    with pytest.raises(ArriveError, match=r"no policy of arrive: it is truncated, corrupt"):
        Controller.load(path)
    with pytest.raises(SystemExit):
        main(["verify", str(path)])
    assert capsys.readouterr().err.count("\n") == 1


def test_every_flipped_bit_is_noticed(small, tmp_path):
    """1,000 single bits of a whole file, weights, metadata and checksum alike."""
    content, rng = small.read_bytes(), np.random.default_rng(3)
    path = tmp_path / "flipped.onnx"
    # The checksum and the bytes before it too, which random places would seldom meet.
    places = [*rng.integers(8 * len(content), size=900), *(8 * len(content) - 1 - rng.integers(8 * 100, size=100))]
    for place in places:
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        with pytest.raises(ArriveError, match=r"Export the policy again|no policy of arrive"):
            read_policy_file(path)


def test_every_truncation_is_noticed(small, tmp_path):
    content = small.read_bytes()
    for size in np.random.default_rng(4).integers(len(content), size=100):
        (tmp_path / "cut.onnx").write_bytes(content[:size])
        with pytest.raises(ArriveError):
            read_policy_file(tmp_path / "cut.onnx")


@pytest.fixture(scope="module")
def small(run, tmp_path_factory):
    """An export of a network with 8 hidden neurons."""
    policy = load_policy(run)
    torch.manual_seed(0)
    sample = TensorDict({POLICY: torch.zeros(1, 236)}, batch_size=[1])
    actor = make_actor(
        dataclasses.replace(policy.config.ppo, hidden=(8,)), sample, 12, make_reflections(an_env("flat"))
    )
    path = tmp_path_factory.mktemp("small") / "small.onnx"
    export_policy(dataclasses.replace(policy, actor=actor), path)
    return path


def put(section, *places_and_value):
    """An edit that puts a value at a place of a section."""
    *places, value = places_and_value

    def change(content):
        for place in places[:-1]:
            content = content[place]
        content[places[-1]] = value

    return edit(section, change)


NAN, INFINITE = float("nan"), float("inf")
HOSTILE = {
    "NaN limit": (put("robot", "joint_limits_rad", 0, [NAN, 0.5]), "NaN is not a number"),
    "infinite limit": (put("robot", "joint_limits_rad", 0, [-INFINITE, 0.5]), "Infinity is not a number"),
    "huge limit": (put("robot", "joint_limits_rad", 0, [-1e300, 1e300]), "no radians"),
    "reversed limits": (put("robot", "joint_limits_rad", 0, [0.5, -0.5]), "range of LF_HAA .* ascending"),
    "zero limits": (put("robot", "joint_limits_rad", 0, [0.0, 0.0]), "range of LF_HAA"),
    "limits in text": (put("robot", "joint_limits_rad", 0, ["-1", "1"]), "not a finite number"),
    "one limit": (put("robot", "joint_limits_rad", 0, [1.0]), "list of 2 numbers"),
    "eleven limits": (edit("robot", lambda robot: robot["joint_limits_rad"].pop()), "12 ranges"),
    "pose outside": (put("robot", "default_joint_pos_rad", 0, 3.0), "default position of LF_HAA"),
    "no pose": (put("robot", "default_joint_pos_rad", []), "list of 12 numbers"),
    "zero scale": (put("robot", "action_scale_rad", 0.0), "robot.action_scale_rad"),
    "negative scale": (put("robot", "action_scale_rad", -0.5), "robot.action_scale_rad"),
    "true stiffness": (put("robot", "stiffness", True), "robot.stiffness is True"),
    "zero stiffness": (put("robot", "stiffness", 0), "robot.stiffness"),
    "negative damping": (put("robot", "damping", -2.0), "robot.damping"),
    "zero effort": (put("robot", "effort_limit", 0.0), "robot.effort_limit"),
    "stall below effort": (put("robot", "stall_torque", 10.0), "stall_torque is below"),
    "negative speed": (put("robot", "no_load_speed", -7.5), "robot.no_load_speed"),
    "a number too large": (put("robot", "standing_height_m", 10**400), "damaged|standing_height"),
    "same names": (put("robot", "joint_names", 1, "LF_HAA"), "twice"),
    "zero period": (put("control", "period_s", 0), "control.period_s"),
    "no period": (edit("control", lambda control: control.clear()), "damaged"),
    "zero episode": (put("task", "episode_s", 0.0), "task.episode_s"),
    "negative window": (put("task", "reward_window_s", -1.0), "task.reward_window_s"),
    "window beyond the episode": (put("task", "reward_window_s", 99.0), "task.reward_window_s"),
    "reversed distances": (put("task", "target_distance_m", [5.0, 1.0]), "task.target_distance_m"),
    "text for a radius": (put("task", "arrival_radius_m", "0.5"), "task.arrival_radius_m"),
    "zero observation scale": (put("observation", 4, "scale", 0.0), "scale of observation 'time_left'"),
    "half a number": (put("observation", 0, "stop", 3.0), "slice of observation"),
    "negative slice": (put("observation", 0, "stop", -3), "slice of observation"),
    "two of a name": (put("observation", 0, "name", "base_ang_vel"), "same name"),
    "zero grid step": (put("heights", "step_m", 0.0), "heights.step_m"),
    "a point elsewhere": (put("heights", "points_m", 5, [9.0, 9.0]), "not a complete grid"),
    "no points": (put("heights", "points_m", []), "heights.points_m"),
    "clips of one side": (put("heights", "clip_m", [0.1, 0.4]), "heights.clip_m"),
    "golden zeros": (
        edit("golden", lambda golden: golden.update({x: (0 * np.array(golden[x])).tolist() for x in GOLDEN})),
        "golden.observations are all the same",
    ),
    "one golden pair": (
        edit("golden", lambda golden: golden.update({x: golden[x][:1] for x in GOLDEN})), "at least two rows"
    ),
    "no golden pairs": (edit("golden", lambda golden: golden.update({x: [] for x in GOLDEN})), "at least two rows"),
    "a list for a section": (lambda model, text: text.update({PREFIX + "robot": "[]"}), "damaged"),
    "a number for a section": (lambda model, text: text.update({PREFIX + "observation": "3"}), "damaged"),
    "deep JSON": (lambda model, text: text.update({PREFIX + "golden": "[" * 100_000}), "damaged"),
}  # fmt: skip
GOLDEN = ("observations", "actions")


@pytest.mark.parametrize(("change", "message"), HOSTILE.values(), ids=HOSTILE)
def test_values_that_cannot_be_are_refused_though_the_checksum_agrees(small, tmp_path, change, message):
    with pytest.raises(ArriveError, match=message):
        Controller.load(changed(small, tmp_path, change, sealed=True))


def external(location):
    def apply(model, text):
        tensor = first_layer(model)
        onnx.external_data_helper.set_external_data(tensor, location, offset=0, length=len(tensor.raw_data))
        tensor.ClearField("raw_data")

    return apply


def huge(model, text):
    """A constant of 80 GB in a file of some kB."""
    del first_layer(model).dims[:]
    first_layer(model).dims.extend([100_000, 200_000])


def with_operator(operator, domain=""):
    def apply(model, text):
        model.graph.node.append(onnx.helper.make_node(operator, ["observation"], ["more"], domain=domain))

    return apply


def with_node(operator, inputs, **attributes):
    def apply(model, text):
        model.graph.node.append(onnx.helper.make_node(operator, inputs, ["more"], **attributes))

    return apply


def weight(value):
    def apply(model, text):
        weights = numpy_helper.to_array(first_layer(model)).copy()
        weights[0, 0] = value
        first_layer(model).CopyFrom(numpy_helper.from_array(weights, "w0"))

    return apply


def with_constant(model, text):
    """A tensor in a node's attribute, where another check of sizes would be needed."""
    value = numpy_helper.from_array(np.zeros(3, np.float32))
    model.graph.node[0].attribute.append(onnx.helper.make_attribute("value", value))


def first_layer(model):
    return next(tensor for tensor in model.graph.initializer if tensor.name == "w0")


def doubles(model, text):
    first = first_layer(model)
    first.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(first).astype(np.float64), first.name))


NETWORKS = {
    "external data": (external("weights.bin"), "external data"),
    "external data by path": (external("/etc/passwd"), "external data"),
    "huge": (huge, r"declared as \[100000, 200000\]"),
    "other operator": (with_operator("Relu"), "operator 'Relu'"),
    "foreign operator": (with_operator("Gemm", "com.example"), "foreign operator"),
    "foreign set": (lambda m, t: m.opset_import.append(onnx.helper.make_opsetid("com.example", 1)), "foreign"),
    "constant": (with_constant, "AttributeProto has a tensor"),
    "product of constants": (with_node("Mul", ["w0", "w0"]), "works on constants"),
    "spread constants": (with_node("Mul", ["observation", "w0"]), "'w0' have 2 dimensions"),
    "rows of a matrix": (with_node("Gather", ["w0", "o0_index"], axis=1), "works on constants"),
    "rows of the batch": (with_node("Gather", ["observation", "o0_index"], axis=0), "other attributes"),
    "turned layer": (with_node("Gemm", ["observation", "w0"], transA=1), "other attributes"),
    "function": (lambda m, t: m.functions.add(), "functions of its own"),
    "NaN weight": (weight(np.nan), "not finite"),
    "infinite weight": (weight(np.inf), "not finite"),
    "other weight": (weight(1e37), "golden actions differ"),
    "doubles": (doubles, "neither 32-bit"),
    "a loop": (lambda m, t: m.graph.node[-1].input.__setitem__(1, "action"), "onnxruntime cannot run"),
    "other input": (lambda m, t: setattr(m.graph.input[0], "name", "x"), "onnxruntime cannot run|must map"),
}


@pytest.mark.parametrize(("change", "message"), NETWORKS.values(), ids=NETWORKS)
def test_networks_that_no_export_writes_are_refused(small, tmp_path, change, message, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights.bin").write_bytes(bytes(100_000))
    path = changed(small, tmp_path, change, sealed=True)
    for read in (Controller.load, verify):
        with pytest.raises(ArriveError, match=message):
            read(path)


def test_random_bytes_under_a_good_checksum_are_refused_in_one_line(small, tmp_path):
    """500 damages that someone has sealed again: one line says what is wrong, or the policy still runs."""
    body, rng, messages = small.read_bytes()[:-SEAL_SIZE], np.random.default_rng(5), []
    for _ in range(500):
        damaged = bytearray(body)
        # Most of a file are numbers of weights and golden pairs; the structure is at the beginning and between them.
        for place in rng.integers(len(damaged), size=2):
            damaged[place] = rng.integers(256)
        start = rng.integers(0, 400)
        damaged[start : start + rng.integers(0, 4)] = rng.bytes(rng.integers(0, 4))
        (tmp_path / "damaged.onnx").write_bytes(seal(bytes(damaged)))
        messages.append(refusal(tmp_path / "damaged.onnx"))
    assert not [message for message in messages if "\n" in message]
    assert sum(map(bool, messages)) > 350


def refusal(path) -> str:
    """Why a file is not loaded, empty where it is."""
    try:
        Controller.load(path)
    except ArriveError as error:
        return str(error)
    return ""


def test_a_file_of_the_format_before_says_so(exported, tmp_path):
    (tmp_path / "old.onnx").write_bytes(exported.read_bytes()[:-SEAL_SIZE])
    with pytest.raises(ArriveError, match="truncated, or of another version of arrive"):
        read_policy_file(tmp_path / "old.onnx")


def test_export_leaves_the_file_before_where_it_fails(run, tmp_path, monkeypatch):
    out = tmp_path / "policy.onnx"
    out.write_bytes(b"before")

    def full(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("arrive.files.os.fsync", full)
    with pytest.raises(ArriveError, match=r"cannot write .*policy.onnx: .*No space left.* Free some space"):
        export_policy(load_policy(run), out)
    log = ControlLog()
    with pytest.raises(ArriveError, match="No space left"):
        log.save(out)
    assert out.read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == ["policy.onnx"]


def test_labels_of_cells_may_be_rounded_but_not_moved(exported, tmp_path):
    def rounded(terms):
        terms[8]["labels"] = [f"({float(x):.1f}, {float(y):.1f})" for x, y in
                              (label.strip("()").split(",") for label in terms[8]["labels"])]  # fmt: skip

    verify(changed(exported, tmp_path, edit("observation", rounded), sealed=True))
    moved = put("observation", 8, "labels", 3, "(5.0, 5.0)")
    with pytest.raises(ArriveError, match=r"observation\[8\].labels\[3\] is '\(5.0, 5.0\)' there"):
        verify(changed(exported, tmp_path, moved, sealed=True))


def test_export_refuses_a_network_that_is_broken(run, tmp_path):
    policy = load_policy(run)
    with torch.no_grad():
        policy.actor.mlp[0].weight[0, 0] = torch.nan
    with pytest.raises(ArriveError, match="not finite"):
        export_policy(policy, tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ArriveError, match="there is no file"):
        Controller.load(tmp_path / "none.onnx")


def test_velocity_policy_can_be_exported_but_not_driven_to_targets(tmp_path):
    config = dataclasses.replace(CONFIG, task=get_task("velocity").from_preset(CONFIG.task))
    Trainer(config, build_env(config, threads=1), tmp_path).save()
    export_policy(load_policy(tmp_path), tmp_path / "v.onnx")
    verify(tmp_path / "v.onnx")
    with pytest.raises(ArriveError, match="speed_command"):
        Controller.load(tmp_path / "v.onnx")


# Log.


def test_replay_gives_identical_commands(exported, tmp_path):
    log, rng = ControlLog(), np.random.default_rng(0)
    controller = Controller.load(exported, log=log)
    heights = rng.normal(0, 0.05, (60, 60))
    heights[:20] = np.nan
    goals = [Target((3.0, 1.0, 0.5), 0.6), Joystick(0.4, -0.6), WayPoints(((1.0, 0.0, 0.5), (2.0, 1.0, 0.5))), None]
    for i in range(160):
        now = i * DT
        changes = {"joint_vel": rng.normal(size=12), "base_pos_w": np.array([0.01 * i, 0.0, 0.5])}
        if i in (30, 31, 70):
            changes["joint_pos"] = (np.zeros(3), None, np.full(12, np.nan))[i % 3]
        terrain = HeightMap((-1.5, -1.5), 0.05, heights, now) if i % 2 else "nothing" if i == 90 else flat(now)
        goal = goals[3] if i == 125 else goals[i // 60]
        controller.step(standing(controller, now, **changes), goal, terrain, now)
    log.save(tmp_path / "log.npz")
    loaded = ControlLog.load(tmp_path / "log.npz")
    again = replay(loaded, Controller.load(exported))
    assert {command.mode for command in again} == {"target", "hold", "joystick", "way_points", "safe"}
    for logged, read, new in zip(log.commands, loaded.commands, again, strict=True):
        np.testing.assert_array_equal(logged.targets, new.targets)
        np.testing.assert_array_equal(logged.targets, read.targets)
        assert (logged.mode, logged.reason) == (new.mode, new.reason) == (read.mode, read.reason)
    loaded.policy_digest = "other"
    with pytest.raises(ArriveError, match="another policy"):
        replay(loaded, controller)
    (tmp_path / "log.npz").write_bytes(b"PK")
    with pytest.raises(ArriveError, match="not a controller's log"):
        ControlLog.load(tmp_path / "log.npz")


# Without the training stack.

ALONE = """
import sys

class Forbid:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in FORBIDDEN:
            raise ImportError(f"{name} must not be needed")

FORBIDDEN = {"torch", "mujoco", "rsl_rl", "tensordict", "onnx", "tyro", "rich", "matplotlib", "PIL", "imageio"}
sys.meta_path.insert(0, Forbid())
import numpy as np
from arrive.deployment import Controller, GridHeights, Joystick, Sensors

controller = Controller.load(sys.argv[1])
robot = controller.policy.robot
sensors = Sensors(robot.default_joint_pos_rad, np.zeros(12), (0, 0, 0.5), (1, 0, 0, 0), np.zeros(3), np.zeros(3), 0.0)
command = controller.step(sensors, Joystick(1.0, 0.0), GridHeights(np.zeros(187), 0.0), 0.0)
assert not FORBIDDEN & {name.split(".")[0] for name in sys.modules}, sys.modules
print(command.mode, command.targets.tolist())
"""


def test_controller_runs_without_torch_and_mujoco(exported, controller):
    result = subprocess.run([sys.executable, "-c", ALONE, str(exported)], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    mode, targets = result.stdout.split(" ", 1)
    assert mode == "joystick"
    np.testing.assert_array_equal(json.loads(targets), step(controller, 0.0).targets)


def test_safety_is_adjustable(exported):
    patient = Controller.load(exported, Safety(sensors_age_s=2.0))
    assert step(patient, 1.5, time_s=0.0).mode == "joystick"
