"""Energy per metre: sums of scripted motors, and robots that arrive, fall or stand."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from arrive.commands.results import effort_of, keep_longer
from arrive.config import override
from arrive.errors import ArriveError
from arrive.evaluation import walking
from arrive.evaluation.energy import GRAVITY, check_energy_arguments, energy_content, measure_energy, row, walk
from arrive.evaluation.estimate import Z, mean, ratio
from arrive.evaluation.motors import MeteredPhysics, meter
from arrive.evaluation.walking import (
    Heading,
    check_command,
    constant_command,
    possible,
    slower_words,
    walking_env,
)
from arrive.files import write_json
from arrive.learning.policy import Policy
from arrive.presets import get_preset
from arrive.report.energy_chart import energy_figure
from arrive.report.figure import svg_text
from arrive.task.registry import get_task
from arrive.terms import LEAD_M


def a_policy(task: str = "final") -> Policy:
    """A policy of a task that holds the default pose."""
    config = override(get_preset("paper"), ("num_envs=1",))
    config = replace(config, task=get_task(task).from_preset(config.task))
    still = lambda observations: torch.zeros(len(observations["policy"]), 12)  # noqa: E731
    return Policy(Path(f"{task}/policy.pt"), config, [], "none", 0, still)


@pytest.fixture(autouse=True)
def unchecked(monkeypatch):
    """Scripted policies read no observation; few worlds compile faster."""
    monkeypatch.setattr(Policy, "check", lambda self, env: None)
    monkeypatch.setattr(walking, "VARIANTS", 1)


class Treadmill:
    """An engine of which only the readings are used: they are scripted."""

    num_envs, device = 2, torch.device("cpu")

    def __init__(self):
        self.steps = 0

    def step(self, joint_targets):
        self.steps += 1

    def deactivate(self, env_ids):
        self.inactive = env_ids.tolist()

    def read(self):
        torque = torch.tensor([[3.0, -4.0], [1.0, 0.0]])
        speed = torch.tensor([[2.0, 0.5], [1.0, 1.0]]) * self.steps
        return SimpleNamespace(joint_torque=torque, joint_vel=speed, finite=torch.tensor([True, True]))


def test_energy_is_summed_over_every_physics_step():
    """Four steps of 5 ms: torques stay, speeds are 1, 2, 3 and 4 times the first ones."""
    engine = Treadmill()
    physics = MeteredPhysics(engine, 4, 0.005)
    physics.step(torch.zeros(2, 2))
    assert engine.steps == 4
    assert physics.torque_sq.tolist() == pytest.approx([25.0 * 0.02, 1.0 * 0.02])
    assert physics.positive_work.tolist() == pytest.approx([6.0 * 10 * 0.005, 1.0 * 10 * 0.005])
    assert physics.absolute_work.tolist() == pytest.approx([8.0 * 10 * 0.005, 1.0 * 10 * 0.005])


def test_a_robot_whose_walk_has_ended_spends_no_more_energy():
    physics = MeteredPhysics(Treadmill(), 1, 0.01)
    physics.step(torch.zeros(2, 2))
    physics.deactivate(torch.tensor([0]))
    physics.step(torch.zeros(2, 2))
    assert physics.torque_sq.tolist() == pytest.approx([0.25, 0.02])


@pytest.fixture(scope="module")
def walks():
    """Three robots moved by hand: one walks at 1 m/s, one falls after 2.5 m, one stands."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Policy, "check", lambda self, env: None)
        patch.setattr(walking, "VARIANTS", 1)
        env = walking_env(a_policy(), [Heading(1.0)], 3, 30.0, 1, 1)
        motors = meter(env, 1)
    engine, start = motors._engine, env.state.base_pos_w.clone()
    read, clock = engine.read, {"step": 0}

    def step(targets):
        clock["step"] += 1

    def scripted(env_ids=None):
        time_s = clock["step"] * 0.005
        moved = start + torch.tensor([[1.0, 0.0, 0.0], [1.0, 0.2, 0.0], [0.0, 0.0, 0.0]]) * time_s
        crashed = torch.tensor([0.0, float(time_s >= 2.5), 0.0])
        values = {
            "base_pos_w": moved,
            "crash_contacts": crashed,
            "joint_torque": torch.full((3, 12), 2.0),
            "joint_vel": torch.tensor([0.5] * 6 + [-0.5] * 6).repeat(3, 1),
        }
        rows = slice(None) if env_ids is None else env_ids
        return replace(read(env_ids), **{name: value[rows] for name, value in values.items()})

    engine.step, engine.read = step, scripted
    told = []
    walks = walk(env, a_policy(), motors, 4.0, lambda i, n: told.append((i, n)))
    assert told[-1] == (12, 12)
    return walks


class TestWalk:
    def test_robots_end_at_the_distance_by_falling_or_by_standing(self, walks):
        assert walks.finished.tolist() == [True, False, False]
        assert walks.fell.tolist() == [False, True, False]
        assert walks.way_m.tolist() == pytest.approx([4.0, 2.48, 0.0], abs=0.03)
        assert walks.time_s.tolist() == pytest.approx([4.0, 2.5, 10.0], abs=0.03)

    def test_sums_of_energy_equal_a_hand_computation(self, walks):
        assert walks.torque_sq.tolist() == pytest.approx((12 * 4.0 * walks.time_s).tolist(), rel=1e-4)
        assert walks.positive_work.tolist() == pytest.approx((6 * 1.0 * walks.time_s).tolist(), rel=1e-4)
        assert walks.absolute_work.tolist() == pytest.approx((12 * 1.0 * walks.time_s).tolist(), rel=1e-4)
        # ANYmal C weighs 52 kg, give or take the payload of at most 5 kg.
        assert walks.weight.tolist() == pytest.approx([52 * GRAVITY] * 3, abs=6 * GRAVITY)

    def test_a_row_has_costs_per_metre_and_the_numbers_of_falls_and_stops(self, walks):
        figures = row(1.0, walks, torch.tensor([True, True, True]), 4.0)
        assert (figures["robots"], figures["finished"], figures["fell"], figures["stood"]) == (3, 1, 1, 1)
        assert figures["metres"] == pytest.approx(6.48, abs=0.05)
        # Both walkers move at 1 m/s and spend 48 N^2 m^2 s and 6 J in a second.
        assert figures["speed"][0] == pytest.approx(1.0, abs=0.01)
        assert figures["torque_sq"][0] == pytest.approx(48.0, rel=0.01)
        assert figures["positive_work"][0] == pytest.approx(6.0, rel=0.01)
        assert figures["absolute_work"][0] == pytest.approx(12.0, rel=0.01)
        assert figures["cost_of_transport"][0] == pytest.approx(6.0 / float(walks.weight[:2].mean()), rel=0.05)
        assert figures["time_s"] is None, "one robot alone has no interval"


def test_a_ratio_has_the_interval_of_the_delta_method():
    value, low, high = ratio(torch.tensor([2.0, 4.0, 6.0]), torch.tensor([1.0, 2.0, 2.0]))
    # R = 12 / 5; residuals -0.4, -0.8, 1.2; variance 2.24 / 2 * 3 / 25.
    assert value == pytest.approx(2.4)
    assert high - low == pytest.approx(2 * Z * (2.24 / 2 * 3 / 25) ** 0.5)
    assert mean(torch.tensor([1.0])) is None


class TestCommand:
    HEADINGS = (Heading(0.5), Heading(1.5, 90.0))

    def test_final_keeps_its_distance_and_varies_the_time(self):
        command = constant_command(a_policy("final"), list(self.HEADINGS), 10.0)
        assert command.offset_w.tolist() == [pytest.approx([3.0, 0.0]), pytest.approx([0.0, 3.0], abs=1e-6)]
        assert command.time_left_s.tolist() == pytest.approx([6.0, 2.0])

    def test_continuous_keeps_its_time_and_varies_the_distance(self):
        command = constant_command(a_policy("continuous"), list(self.HEADINGS), 10.0)
        assert command.offset_w.norm(dim=-1).tolist() == pytest.approx([1.5, 4.5])
        assert command.time_left_s.tolist() == pytest.approx([3.0, 3.0])

    def test_speeds_below_the_slowest_command_are_measured_once_as_that(self):
        """The paper's episodes have 6 s: 3 m in 6 s is 0.5 m/s, and the 12 s for 0.25 m/s are never observed."""
        policy = a_policy("final")
        asked = [Heading(0.25), Heading(0.5), Heading(1.0), Heading(0.1, 90.0)]
        given = possible(policy, asked)
        assert given == [Heading(0.5), Heading(1.0), Heading(0.5, 90.0)]
        env = walking_env(policy, given, 1, 20.0, 1, 1)
        observed = env.observer.terms[4].compute(env.state, env.task.command)
        assert (LEAD_M / observed).flatten().tolist() == pytest.approx([heading.speed for heading in given])
        assert "0.25, 0.1 m/s is below its slowest command of 0.5 m/s" in slower_words(policy, (0.25, 0.1, 0.5))

    @pytest.mark.parametrize("task", ["velocity", "continuous"])
    def test_the_other_tasks_are_commanded_any_speed(self, task):
        policy = a_policy(task)
        assert possible(policy, [Heading(0.1)]) == [Heading(0.1)]
        assert not slower_words(policy, (0.1,))

    def test_a_row_tells_the_speed_that_was_commanded(self):
        content = measure_energy(a_policy(), (0.25, 0.5), 2, 2.0, 1, 1)
        assert [row["told_m_s"] for row in content["speeds"]] == [0.5]
        assert content["speeds"][0]["robots"] == 2
        assert content["randomisation"]["push_speed"] == 0.0
        assert content["randomisation"]["friction"] == list(a_policy().config.randomisation.friction)

    def test_the_velocity_task_refuses_sideways_commands(self):
        assert constant_command(a_policy("velocity"), [Heading(0.5), Heading(0.5, 180)], 1).speed.tolist() == [
            0.5,
            -0.5,
        ]
        with pytest.raises(ArriveError, match="not towards 90 deg"):
            check_command(a_policy("velocity"), self.HEADINGS)

    def test_a_task_without_constant_commands_is_refused_in_one_line(self, monkeypatch):
        monkeypatch.setattr(walking, "get_task", lambda name: SimpleNamespace)
        with pytest.raises(ArriveError, match="takes no constant command"):
            check_command(a_policy())

    @pytest.mark.parametrize("task", ["final", "continuous", "velocity"])
    def test_a_constant_command_never_changes_and_never_ends(self, task):
        policy = a_policy(task)
        env = walking_env(policy, [Heading(1.0)], 1, 20.0, 1, 1)
        told = []
        for _ in range(3):
            state, command = env.state, env.task.command
            state.base_pos_w = state.base_pos_w + torch.tensor([40.0, -3.0, 0.0])
            env.task.follow(state)
            assert not env.task.advance(0.02).any()
            told.append(env.observer.terms[3].compute(state, command))
        ahead = env.task.command.target_w - env.state.base_pos_w if task != "velocity" else None
        assert ahead is None or ahead[0, :2].tolist() == pytest.approx([3.0, 0.0], abs=1e-4)
        assert torch.allclose(told[0], told[-1], atol=1e-4)


@pytest.mark.parametrize("bad", [((), 10, 10.0), ((0.0,), 10, 10.0), ((1.0,), 1, 10.0), ((1.0,), 10, float("nan"))])
def test_wrong_arguments_of_a_measurement_are_an_error(bad):
    with pytest.raises(ArriveError):
        check_energy_arguments(*bad)


def a_row(told: float, **figures) -> dict:
    known = {"robots": 4, "finished": 4, "fell": 0, "stood": 0, "metres": 40.0}
    values = dict.fromkeys(("torque_sq", "positive_work", "absolute_work", "cost_of_transport", "speed", "time_s"))
    return {"told_m_s": told} | known | values | figures


def a_result(robots: int = 4) -> dict:
    walked = {"torque_sq": [50.0, 40.0, 60.0], "cost_of_transport": [0.5, 0.4, 0.6], "speed": [0.9, 0.8, 1.0]}
    policies = [
        {"name": name, "task": task, "speeds": [a_row(0.5, **walked), a_row(1.0, fell=4)]}
        for name, task in (("v", "velocity"), ("p", "final"), ("q", "final"))
    ]
    return energy_content(policies, robots, 10.0, 1)


def test_the_figure_has_a_colour_per_policy():
    text = svg_text(energy_figure(a_result()))
    assert all(color in text for color in ("#d55e00", "#0072b2", "#cc79a7"))


def test_a_shorter_measurement_does_not_replace_a_longer_one(tmp_path):
    path = tmp_path / "energy.json"
    write_json(path, a_result(robots=50))
    assert effort_of(a_result(robots=50)) == 3 * 2 * 50 * 10.0
    keep_longer(path, "energy", 3000.0, False)
    with pytest.raises(ArriveError, match="--force"):
        keep_longer(path, "energy", 2999.0, False)
    keep_longer(path, "energy", 1.0, True)
