"""The controller: the same actions as in training, and no unsafe command for any input."""

import contextlib
import json
import math
import random
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import arrive.deployment
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
from arrive.deployment.command import JointCommand
from arrive.deployment.inputs import ARRAYS, frame_of
from arrive.deployment.policy_file import read_policy_file
from arrive.deployment.terms import COMPUTED
from arrive.env import POLICY
from arrive.errors import ArriveError
from arrive.learning.policy import load_policy
from controllers import AHEAD, DT, POINTS, an_env, assert_safe, flat, sensors_of, standing, step

# The same as in training.


def test_the_exported_file_gives_the_actions_of_the_training_policy(run, exported):
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
def test_the_controller_has_the_observations_and_targets_of_the_environment(family, run, exported):
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
    "infinite": GridHeights(np.full(POINTS, np.inf), 1.0),
    "old": GridHeights(np.zeros(POINTS), -5.0),
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
        step(controller, i * DT, terrain=GridHeights(scale * rng.normal(size=POINTS), i * DT), **changes)


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
            "heights": np.zeros(POINTS),
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


def test_after_a_spike_the_policy_observes_the_held_pose_as_its_last_action(controller, monkeypatch):
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


def test_a_stop_does_not_hold_the_position_of_a_spike(controller):
    trot = Trot(controller)
    act_on(controller, trot.at(0), AHEAD)
    act_on(controller, trot.at(1) | {"base_pos_w": np.array([900.0, 0.0, 0.55])}, Joystick(0.0, 0.0))
    for i in range(2, 40):
        command = act_on(controller, trot.at(i), Joystick(0.0, 0.0))
    assert command.mode == "stop"
    assert abs(controller._navigator._anchor[0]) < 1.0


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
def test_impossible_measurements_are_refused_and_recovery_takes_half_a_second(controller, changes, mode, reason):
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
def test_a_recovery_time_that_is_not_positive_is_refused(value):
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
        (lambda s, g, t: (s, g, GridHeights(0.0, np.zeros(POINTS))), "heights_w is of shape (), not 1 dimension"),
    ],
)
def test_swapped_arguments_are_reported(controller, arguments, reason):
    command = controller.step(*arguments(standing(controller, 0.0), AHEAD, flat(0.0)), 0.0)
    assert command.mode == "safe"
    assert reason in command.reason


def test_the_controller_has_the_observation_terms_of_training(controller):
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


@pytest.mark.parametrize("points", [187, 1683])
def test_a_log_takes_4_bytes_per_grid_point_and_1_kb_per_step(points, tmp_path):
    """In memory and in the file before compression; 1683 points are the grid of `robust`."""
    log, steps, rng = ControlLog(), 50, np.random.default_rng(0)
    for i in range(steps):
        sensors = Sensors(np.zeros(12), np.zeros(12), np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(3), i * DT)
        heights = GridHeights(rng.normal(size=points), i * DT)
        frame = frame_of(sensors, Joystick(1.0, 0.0), heights, i * DT, None)
        log.append(SimpleNamespace(digest="0"), frame, JointCommand(np.zeros(12), "joystick", ""))
    assert sum(getattr(frame, name).nbytes for frame in log.frames for name in ARRAYS) < steps * (4 * points + 500)
    log.save(tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz") as file:
        assert sum(file[name].nbytes for name in file.files) < steps * (4 * points + 1000)


def test_a_damaged_log_is_refused_in_one_line(controller, tmp_path):
    """Also where only the compressed bytes are damaged, which neither zip nor NumPy reports as an error of its own."""
    path, rng = tmp_path / "log.npz", random.Random(1)
    controller.log = log = ControlLog()
    for i in range(20):
        step(controller, i * DT)
    log.save(path)
    whole = path.read_bytes()
    for place in rng.sample(range(8 * len(whole)), 200):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << place % 8
        path.write_bytes(damaged)
        with contextlib.suppress(ArriveError):
            loaded = ControlLog.load(path)
            np.testing.assert_array_equal([c.targets for c in loaded.commands], [c.targets for c in log.commands])
    for content in (b"", b"PK", whole[:-1], whole + b"\0", b"{}"):
        path.write_bytes(content)
        with pytest.raises(ArriveError, match="damaged or no NPZ file"):
            ControlLog.load(path)
    np.savez(path, texts="[]", targets=np.zeros(3))
    with pytest.raises(ArriveError, match="not a controller's log"):
        ControlLog.load(path)


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
ground = GridHeights(np.zeros(len(controller.policy.grid.points_m)), 0.0)
command = controller.step(sensors, Joystick(1.0, 0.0), ground, 0.0)
assert not FORBIDDEN & {name.split(".")[0] for name in sys.modules}, sys.modules
print(command.mode, command.targets.tolist())
"""


def test_controller_runs_without_torch_and_mujoco(exported, controller):
    result = subprocess.run([sys.executable, "-c", ALONE, str(exported)], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    mode, targets = result.stdout.split(" ", 1)
    assert mode == "joystick"
    np.testing.assert_array_equal(json.loads(targets), step(controller, 0.0).targets)


def test_the_first_step_prepares_nothing(exported, monkeypatch):
    """Preparing takes more than half a control period, so it happens before the robot moves, and leaves no trace."""
    counted = []
    gravity = COMPUTED["gravity"]
    monkeypatch.setitem(
        COMPUTED, "gravity", replace(gravity, compute=lambda m: (counted.append(None), gravity.compute(m))[1])
    )
    log = ControlLog()
    controller = Controller.load(exported, log=log)
    assert len(counted) == 1
    assert not log.frames
    first = [step(controller, DT * k).targets for k in range(3)]
    controller.reset()
    np.testing.assert_array_equal(first, [step(controller, DT * k).targets for k in range(3)])


def test_safety_is_adjustable(exported):
    patient = Controller.load(exported, Safety(sensors_age_s=2.0))
    assert step(patient, 1.5, time_s=0.0).mode == "joystick"
