"""Every reward term by its hand-computed value, and the weights that presets give them."""

import ast
import math
from dataclasses import fields, replace
from pathlib import Path

import pytest
import torch

from arrive.build import build_env
from arrive.config import Config, override
from arrive.errors import ArriveError
from arrive.presets import PRESETS, get_preset
from arrive.task import rewards
from arrive.task.final import FinalConfig
from arrive.task.registry import TASKS
from arrive.task.rewards import CRASH_COST, Approach, Cost, PositionRewards, Rewarder, bound, functions
from arrive.task.rotation import quat_of_yaw
from arrive.task.state import Command, State

CONFIG = FinalConfig(reward_window_s=1.0, arrival_radius=0.5)


def a_state(**values) -> State:
    """One robot; fields that are not given are not read."""
    unread = {field.name: torch.full((1, 3), torch.nan) for field in fields(State)}
    return State(**unread | {name: torch.tensor([value], dtype=torch.float32) for name, value in values.items()})


def a_command(target=(0.0, 0.0, 0.0), time_left_s: float = 6.0) -> Command:
    target_w, time_left = torch.tensor([target], dtype=torch.float32), torch.tensor([time_left_s])
    return Command(target_w, time_left, torch.ones(1), torch.ones(1, dtype=torch.bool))


def value_of(name: str, state: State, command: Command, config: FinalConfig = CONFIG) -> float:
    value = bound(name, config)(state, command)
    assert value.shape == (1,)
    return float(value)


@pytest.mark.parametrize(
    ("time_left_s", "window_s", "expected"),
    [
        (0.02, 1.0, 0.1),  # offset (2, 2, 1): 1 / (1 + 9)
        (0.98, 1.0, 0.1),
        (1.0, 1.0, 0.0),  # eq. 1 wants t > T - T_r, not t = T - T_r
        (1.02, 1.0, 0.0),
        (1.02, 2.0, 0.05),  # 1 / T_r
        (2.0, 2.0, 0.0),
    ],
)
def test_task_reward_is_paid_inside_the_window_only(time_left_s, window_s, expected):
    config = replace(CONFIG, reward_window_s=window_s)
    state, command = a_state(base_pos_w=(1.0, 2.0, 0.5)), a_command((3.0, 4.0, 1.5), time_left_s)
    assert value_of("task", state, command, config) == pytest.approx(expected)


@pytest.mark.parametrize("window_s", [0.5, 1.0, 2.0])
def test_task_reward_of_a_robot_at_the_target_integrates_to_one(window_s):
    config = replace(CONFIG, reward_window_s=window_s)
    state = a_state(base_pos_w=(0.0, 0.0, 0.0))
    steps = (a_command(time_left_s=0.02 * k) for k in range(300))
    assert 0.02 * sum(value_of("task", state, step, config) for step in steps) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("velocity", "target", "cosine"),
    [
        ((1.0, 0.0, 0.0), (1.0, 1.0, 0.0), 0.5**0.5),
        ((0.01, 0.0, 0.0), (1.0, 1.0, 0.0), 0.5**0.5),  # however slow
        ((0.0, -2.0, 0.0), (0.0, 3.0, 0.0), -1.0),
        ((0.0, 0.0, 1.0), (3.0, 0.0, 4.0), 0.8),  # in all three dimensions
        ((0.0, 2.0, 0.0), (5.0, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.0), (5.0, 0.0, 0.0), 0.0),  # at rest nothing is earned, and nothing is divided by zero
    ],
)
def test_exploration_reward_is_the_cosine_to_the_target(velocity, target, cosine):
    start = (0.5, -0.25, 0.5)
    state = a_state(base_pos_w=start, base_lin_vel_w=velocity)
    command = a_command([a + b for a, b in zip(start, target, strict=True)])
    assert value_of("exploration", state, command) == pytest.approx(cosine, abs=1e-6)


@pytest.mark.parametrize(
    ("speed", "distance", "expected"),
    [
        (0.0, 5.0, 1.0),
        (0.0999, 0.501, 1.0),
        (0.1001, 5.0, 0.0),  # walking
        (0.0, 0.5, 0.0),  # waiting is no stalling at 0.5 m
        (0.0, 0.499, 0.0),
        (0.1001, 0.499, 0.0),
    ],
)
def test_stalling_is_waiting_slower_than_10_cm_per_s_farther_away_than_half_a_metre(speed, distance, expected):
    for axis in range(3):
        along = torch.eye(3)[axis]
        state = a_state(base_pos_w=(0.0, 0.0, 0.0), base_lin_vel_w=(speed * along).tolist())
        assert value_of("stall_cost", state, a_command((distance * along).tolist())) == expected


PENALTIES = (
    ("joint_acc_cost", {"joint_acc": (1.0, -2.0, 3.0)}, 14.0),
    ("torque_cost", {"joint_torque": (10.0, 0.0, -20.0)}, 500.0),
    ("collision_cost", {"collision_contacts": 3.0}, 3.0),
    ("action_rate_cost", {"action": (1.0, 0.5), "previous_action": (-1.0, 0.0)}, 4.25),
    ("foot_acc_cost", {"foot_acc_w": ((1.0, 2.0, 0.0), (0.0, 0.0, -3.0))}, 14.0),
    ("pose_cost", {"joint_offset": (0.5, -1.0, 0.0)}, 1.25),
)


@pytest.mark.parametrize(("name", "fields_", "expected"), PENALTIES)
def test_penalties(name, fields_, expected):
    assert value_of(name, a_state(**fields_), a_command()) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("velocity", "target", "expected"),
    [
        ((0.5, 0.0, 0.0), (3.0, 4.0, 0.0), 0.3),  # 0.5 * 3/5, of 1 m/s
        ((0.5, 0.0, 0.0), (3.0, 4.0, 7.0), 0.3),  # height does not count
        ((9.0, 0.0, 0.0), (3.0, 0.0, 0.0), 1.0),
        ((-9.0, 0.0, 0.0), (3.0, 0.0, 0.0), -1.0),
        ((0.0, -9.0, 0.0), (0.0, 0.49, 0.0), 1.0),  # there, whatever it does
        ((0.0, -0.2, 0.0), (0.0, 0.51, 0.0), -0.2),
        ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0),
    ],
)
def test_approach_reward_is_the_speed_towards_the_target_up_to_a_limit(velocity, target, expected):
    state = a_state(base_pos_w=(0.0, 0.0, 0.0), base_lin_vel_w=velocity)
    assert value_of("approach", state, a_command(target)) == pytest.approx(expected)
    twice = replace(CONFIG, rewards=PositionRewards(approach=Approach(speed=2.0)))
    if 0.0 < abs(expected) < 1.0:
        assert value_of("approach", state, a_command(target), twice) == pytest.approx(expected / 2)


@pytest.mark.parametrize(
    ("velocity", "max_speed", "expected"),
    [
        (1.5, 1.5, 1.0),
        (1.8, 1.5, 0.7),  # 0.3 m/s too fast, of 1 m/s
        (2.5, 1.5, 0.0),
        (9.0, 1.5, 0.0),  # never below standing still
        (9.0, 0.0, 1.0),  # no limit
        (0.5, 1.5, 0.5),
        (-9.0, 1.5, -1.0),
    ],
)
def test_approach_reward_falls_above_the_speed_that_is_enough(velocity, max_speed, expected):
    state = a_state(base_pos_w=(0.0, 0.0, 0.0), base_lin_vel_w=(velocity, 0.0, 0.0))
    config = replace(CONFIG, rewards=PositionRewards(approach=Approach(max_speed=max_speed)))
    assert value_of("approach", state, a_command((3.0, 0.0, 0.0)), config) == pytest.approx(expected)
    assert value_of("approach", state, a_command((0.3, 0.0, 0.0)), config) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("distance", "velocity", "expected"),
    [
        (3.0, 0.8, 0.8),  # far away, as without
        (3.0, 1.7, 0.8),  # 0.2 m/s above the limit of 1.5 m/s
        (0.8, 0.8, 1.0),  # 0.8 m/s is enough at 0.8 m
        (0.8, 0.4, 0.5),
        (0.8, -0.4, -0.5),
        (0.8, 1.2, 1.0),  # the limit there
        (0.8, 1.5, 0.7),
    ],
)
def test_approach_reward_asks_for_less_speed_near_the_target(distance, velocity, expected):
    state = a_state(base_pos_w=(0.0, 0.0, 0.0), base_lin_vel_w=(velocity, 0.0, 0.0))
    config = replace(CONFIG, rewards=PositionRewards(approach=Approach(max_speed=1.5, braking=1.0)))
    assert value_of("approach", state, a_command((distance, 0.0, 0.0)), config) == pytest.approx(expected)


@pytest.mark.parametrize(
    "change", [{"rewards": PositionRewards(approach=Approach(radius=0.25))}, {"arrival_radius": 0.25}], ids=str
)
def test_approach_reward_is_full_within_the_smaller_of_two_radii(change):
    state = a_state(base_pos_w=(0.0, 0.0, 0.0), base_lin_vel_w=(0.0, -9.0, 0.0))
    config = replace(CONFIG, **change)
    assert value_of("approach", state, a_command((0.0, 0.49, 0.0)), config) == pytest.approx(-1.0)
    assert value_of("approach", state, a_command((0.0, 0.24, 0.0)), config) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("yaw_deg", "facing", "expected"),
    [
        (0.0, 1.0, 0.5),
        (60.0, 1.0, 0.25),
        (-60.0, 1.0, 0.25),
        (90.0, 1.0, 0.0),  # sideways
        (180.0, 1.0, 0.5),  # backwards
        (60.0, 0.8, 0.3125),  # 0.5 * cos 60 deg / 0.8
        (60.0, 0.4, 0.5),  # within the free angle
        (90.0, 0.0, 0.5),
    ],
)
def test_approach_reward_prefers_to_face_the_target(yaw_deg, facing, expected):
    quat = quat_of_yaw(torch.tensor([math.radians(yaw_deg)]))[0]
    state = a_state(base_pos_w=(0.0, 0.0, 0.0), base_lin_vel_w=(0.5, 0.0, 0.0), base_quat_w=tuple(quat.tolist()))
    config = replace(CONFIG, rewards=PositionRewards(approach=Approach(facing=facing)))
    for height in (0.0, 7.0):
        assert value_of("approach", state, a_command((3.0, 0.0, height)), config) == pytest.approx(expected, abs=1e-6)
    assert value_of("approach", state, a_command((0.4, 0.0, 0.0)), config) == pytest.approx(1.0)


def test_stand_reward_is_earned_at_rest_at_the_target_in_the_window():
    def earned(speed: float, distance: float, time_left_s: float) -> float:
        state = a_state(base_pos_w=(0.0, 0.0, 0.0), base_lin_vel_w=(0.0, speed, 0.0))
        return value_of("stand", state, a_command((distance, 0.0, 0.0), time_left_s), config)

    config = replace(CONFIG, reward_window_s=2.0)
    assert earned(0.0, 0.49, 1.98) == pytest.approx(0.5)
    assert earned(0.0, 0.51, 1.98) == earned(0.0, 0.0, 2.0) == 0.0
    assert 0.0 < earned(1.0, 0.0, 0.0) < earned(0.5, 0.0, 0.0) < 0.5


@pytest.mark.parametrize(
    ("speed", "distance", "time_left_s", "expected"),
    [
        (0.5, 2.0, 4.0, 1.0),
        (0.25, 2.0, 4.0, 0.5),
        (0.75, 2.0, 4.0, 0.5),  # faster than needed
        (1.5, 2.0, 4.0, 0.0),
        (-0.5, 2.0, 4.0, -1.0),
        (0.75, 4.0, 1.0, 0.5),  # late: at most 1.5 m/s is asked for
        (9.0, 0.4, 5.0, 1.0),  # there
    ],
)
def test_pace_reward_is_full_at_the_speed_that_arrives_in_time(speed, distance, time_left_s, expected):
    state = a_state(base_pos_w=(0.0, 0.0, 0.0), base_lin_vel_w=(speed, 0.0, 0.0))
    assert value_of("pace", state, a_command((distance, 0.0, 0.0), time_left_s)) == pytest.approx(expected)


def test_a_crash_is_paid_once_and_not_per_second():
    failed = torch.tensor([True, False])
    config = replace(CONFIG, rewards=PositionRewards(crash_cost=Cost(-2.0), pose_cost=Cost(-1.0)))
    state = a_state(joint_offset=(0.0, 0.0, 0.0), finite=True)
    terms = Rewarder(config, control_dt=0.02).pay(state, a_command(), failed, torch.ones(2))
    assert terms["crash_cost"].tolist() == [-2.0, 0.0]


def test_every_reward_term_has_a_test():
    """Each one's name is given to `value_of`, but for the crash, which is not a rate."""
    tested = set()
    for node in ast.walk(ast.parse(Path(__file__).read_text())):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "value_of":
            tested |= {node.args[0].value} if isinstance(node.args[0], ast.Constant) else {row[0] for row in PENALTIES}
    assert set(functions(PositionRewards())) - {CRASH_COST} == tested
    assert all(getattr(rewards, name) is function for name, function in functions(PositionRewards()).items())


@pytest.mark.parametrize("task", TASKS.values())
def test_every_term_finds_its_parameters(task):
    config = task.Config()
    for name in functions(config.rewards).keys() - {CRASH_COST}:
        assert callable(bound(name, config))


@pytest.mark.parametrize("preset", PRESETS)
def test_weights_of_presets_pay_for_the_task(preset):
    assert PRESETS[preset]().task.rewards.task.weight > 0


def test_a_weight_without_a_term_is_an_error_that_lists_the_terms():
    with pytest.raises(ArriveError, match=r"no 'tusk'\. Did you mean 'task'") as error:
        override(get_preset("paper"), ("task.rewards.tusk=1",))
    assert all(name in str(error.value) for name in functions(PositionRewards()))


def test_no_reward_at_all_is_an_error():
    with pytest.raises(ArriveError, match="no reward with a weight"):
        build_env(Config(num_envs=1, task=FinalConfig(rewards=PositionRewards())), threads=1)
