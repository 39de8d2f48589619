"""Goals: the target and the time left that the policy observes."""

import dataclasses
import math

import numpy as np
import pytest

from arrive.deployment import Joystick, Target, WayPoints
from arrive.deployment.faults import BadInput
from arrive.deployment.goals import Navigator
from arrive.deployment.specs import TaskSpec

TASK = TaskSpec("final", 2.0, 6.0, 0.5, [1.0, 5.0], 0.5)


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


def test_a_missing_goal_does_not_begin_the_way_points_again():
    path, navigator = WayPoints(((1.0, 0.0, 0.5), (3.0, 0.0, 0.5))), Navigator(TASK)
    order(path, pos=(0.9, 0.0, 0.5), navigator=navigator)
    with pytest.raises(BadInput, match="no goal"):
        order(None, pos=(2.0, 0.0, 0.5), navigator=navigator)
    assert order(path, pos=(2.0, 0.0, 0.5), navigator=navigator).target_w[0] == 3.0
