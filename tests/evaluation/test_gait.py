"""Gait analysis of synthetic footfalls, its figure, and the command."""

import numpy as np
import pytest

from arrive.errors import ArriveError
from arrive.evaluation.footfalls import circular, footfalls, gait_name, groups_of, hildebrand, steady
from arrive.evaluation.gait import (
    GaitRecording,
    check_gait_arguments,
    describe_gait,
    foot_labels,
    gait_content,
)
from arrive.evaluation.walking import Heading
from arrive.report.figure import svg_text
from arrive.report.gait_chart import gait_figure, stretches
from arrive.robots import get_robot

DT = 0.02
STEP = 0.041
"""A policy step as a share of the stride of half a second: no phase is known better."""
CORNERS = np.array([[0.4, 0.3], [-0.4, 0.3], [0.4, -0.3], [-0.4, -0.3]])
"""LF, LH, RF, RH."""
GAITS = {
    "trot": (0.0, 0.5, 0.5, 0.0),
    "pace": (0.0, 0.0, 0.5, 0.5),
    "bound": (0.0, 0.4, 0.0, 0.4),
    "pronk": (0.0, 0.02, 0.98, 0.0),
    "walk": (0.0, 0.75, 0.5, 0.25),
    # The paper's figure 5 b: right hind, then left hind and right fore together, then left fore.
    "three-phased": (0.66, 0.33, 0.33, 0.0),
}


def contacts(phases, duty=0.6, stride_s=0.5, seconds=6.0, jitter=0.0, seed=0) -> np.ndarray:
    """(steps, feet) contacts of feet that touch down at these phases of each stride."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds / DT)) * DT
    stands = np.zeros((len(time), len(phases)), dtype=bool)
    for foot, phase in enumerate(phases):
        for stride in range(-2, round(seconds / stride_s) + 2):
            start = (stride + phase + jitter * rng.standard_normal()) * stride_s
            stands[(time >= start - 1e-9) & (time < start + duty * stride_s - 1e-9), foot] = True
    return stands


@pytest.mark.parametrize("name", GAITS)
def test_known_gaits_have_their_names_phases_and_duty_factors(name):
    falls = footfalls(contacts(GAITS[name]), DT)
    assert gait_name(falls, CORNERS) == name
    expected = (np.array(GAITS[name]) - GAITS[name][0]) % 1.0
    assert [min(abs(a - b), 1 - abs(a - b)) for a, b in zip(falls.phase, expected, strict=True)] == pytest.approx(
        [0.0] * 4, abs=STEP
    )
    assert falls.duty == pytest.approx(np.full(4, 0.6), abs=STEP)
    assert falls.frequency_hz == pytest.approx(2.0, rel=0.01)
    assert falls.spread.max() < 0.05


def test_strides_may_begin_with_any_foot():
    falls = footfalls(contacts(GAITS["walk"]), DT, reference=3)
    assert falls.phase == pytest.approx(np.array([0.75, 0.5, 0.25, 0.0]), abs=STEP)


def test_random_steps_have_no_gait_name():
    rng = np.random.default_rng(1)
    spans = rng.integers(4, 16, (4, 60))
    stands = np.stack([np.repeat(np.arange(60) % 2 == 0, row)[:300] for row in spans], axis=1)
    falls = footfalls(stands, DT)
    assert gait_name(falls, CORNERS) == "none"
    assert falls.spread.max() > 0.15


def test_pairs_that_are_not_in_antiphase_are_not_a_trot():
    assert gait_name(footfalls(contacts((0.0, 0.25, 0.25, 0.0)), DT), CORNERS) == "none"


def test_a_walk_stands_for_more_than_half_of_the_stride():
    assert gait_name(footfalls(contacts(GAITS["walk"], duty=0.3), DT), CORNERS) == "none"


def test_six_feet_step_as_a_tripod():
    falls = footfalls(contacts((0.0, 0.5, 0.0, 0.5, 0.0, 0.5)), DT)
    corners = np.array([[x, y] for x in (0.4, 0.0, -0.4) for y in (0.3, -0.3)])
    assert gait_name(falls, corners) == "tripod"
    assert hildebrand(falls, corners) is None


def test_two_feet_have_phases_and_no_gait_name():
    falls = footfalls(contacts((0.0, 0.5)), DT)
    assert falls.phase == pytest.approx(np.array([0.0, 0.5]), abs=STEP)
    assert gait_name(falls, np.array([[0.0, 0.1], [0.0, -0.1]])) == "none"


def test_hildebrands_axes():
    hind, lag = hildebrand(footfalls(contacts(GAITS["walk"], duty=0.7), DT), CORNERS)
    # A lateral-sequence walk: the fore foot follows the hind foot of its side by a quarter.
    assert (hind, lag) == pytest.approx((0.7, 0.25), abs=STEP)
    assert hildebrand(footfalls(contacts(GAITS["trot"]), DT), CORNERS)[1] == pytest.approx(0.5, abs=STEP)


def test_a_short_loss_of_contact_does_not_end_a_stance():
    stands = contacts(GAITS["trot"])
    bounced = stands.copy()
    bounced[5], bounced[105:107] = False, False
    assert (steady(bounced, DT) >= stands)[:120].all()
    assert footfalls(bounced, DT).frequency_hz == pytest.approx(2.0, rel=0.02)


def test_a_robot_that_stands_has_no_gait():
    assert footfalls(np.ones((200, 4), dtype=bool), DT) is None


def test_means_on_the_circle():
    value, spread = circular(np.array([0.95, 0.05]))
    assert min(value, 1 - value) == pytest.approx(0.0, abs=1e-9)
    assert spread == pytest.approx(0.05, abs=0.002)
    assert groups_of(np.array([0.95, 0.05, 0.5])) == [[0, 1], [2]]


def a_record(robots: int = 4) -> GaitRecording:
    """Robots that trot at 1 m/s towards 45 degrees left of their heading; the last one stands, the one before fell."""
    stands = np.stack([contacts(GAITS["trot"], jitter=0.02, seed=i) for i in range(robots)], axis=1)
    steps = len(stands)
    way = np.array([np.cos(np.pi / 4 + 0.3), np.sin(np.pi / 4 + 0.3)])
    ripple = 1.0 + 0.1 * np.sqrt(2.0) * np.sin(np.arange(steps) * DT * 2 * np.pi / 0.25)
    velocity = np.repeat((ripple[:, None] * way)[:, None], robots, axis=1)
    velocity[:, -1] = 0.0
    height = np.repeat(0.5 + 0.02 * np.sqrt(2.0) * np.sin(np.arange(steps) * DT * 2 * np.pi / 0.25)[:, None], robots, 1)
    upright = np.ones(robots, dtype=bool)
    upright[-2] = False
    return GaitRecording(stands, velocity, np.full((steps, robots), 0.3), height, upright)


def test_a_row_describes_the_robots_that_walk():
    gait = describe_gait(a_record(), CORNERS, DT)
    assert (gait["gait"], gait["robots"], gait["fell"], gait["stood"], gait["stepped"]) == ("trot", 4, 1, 1, 2)
    assert gait["travel_deg"] == pytest.approx(45.0, abs=0.1)
    assert gait["speed_m_s"][0] == pytest.approx(1.0, abs=0.01)
    assert gait["stride_length_m"][0] == pytest.approx(0.5, abs=0.01)
    assert gait["speed_oscillation_m_s"][0] == pytest.approx(0.1, rel=0.02)
    assert gait["height_oscillation_m"][0] == pytest.approx(0.02, rel=0.02)
    assert np.array(gait["diagram"]["stands"]).shape == (4, 100)


def test_a_row_without_walking_robots_has_no_gait():
    still = a_record()
    still.velocity[:] = 0.0
    assert describe_gait(still, CORNERS, DT)["gait"] is None


def test_feet_of_a_robot():
    robot = get_robot("anymal_c")
    assert foot_labels(robot) == ["LF", "LH", "RF", "RH"]
    assert (np.sign(robot.foot_corners()) == np.sign(CORNERS)).all()


def test_bars_of_the_diagram():
    assert stretches([1, 1, 0, 0, 1, 0, 1]) == [(0, 2), (4, 1), (6, 1)]


def test_the_figure_names_the_gait():
    row = {"told_m_s": 1.0, "direction_deg": 0.0} | describe_gait(a_record(), CORNERS, DT)
    policy = {"name": "v", "task": "velocity", "feet": ["LF", "LH", "RF", "RH"], "gaits": [row]}
    content = gait_content([policy], 4, 6.0, 1)
    assert content["protocol"]["effort"] == 4 * 6.0
    assert "#d55e00" in svg_text(gait_figure(content))


@pytest.mark.parametrize("bad", [([], 8, 6.0), ([Heading(1.0)], 1, 6.0), ([Heading(1.0)], 8, 0.5)])
def test_nothing_to_look_at_is_an_error(bad):
    with pytest.raises(ArriveError):
        check_gait_arguments(*bad)
