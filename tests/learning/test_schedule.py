"""The schedule of training: gait, climb and finish, and a run that follows it."""

from dataclasses import replace
from itertools import pairwise

import pytest

from arrive.config import ScheduleConfig
from arrive.learning.schedule import MAX_STD, settings_at
from arrive.presets import joystick, robust

CONFIG = replace(robust(), schedule=ScheduleConfig(enabled=True))


def test_the_gait_stage_uses_the_configured_values():
    now = settings_at(CONFIG, spent=0.2, seeking=1.0)
    assert (now.entropy, now.desired_kl) == (CONFIG.ppo.entropy, CONFIG.ppo.desired_kl)
    assert now.max_std == MAX_STD
    assert now.crash_cost == -CONFIG.task.rewards.crash_cost.weight
    assert now.review == 0.0


def test_noise_falls_and_crash_cost_grows_without_jumps():
    shares = [i / 200 for i in range(201)]
    run = [settings_at(CONFIG, spent, seeking=0.0) for spent in shares]
    for before, after in pairwise(run):
        assert after.max_std <= before.max_std
        assert after.crash_cost >= before.crash_cost
        assert after.review >= before.review
        assert after.max_std > 0.85 * before.max_std
        assert after.crash_cost - before.crash_cost < 0.3
    first, last, schedule = run[0], run[-1], CONFIG.schedule
    assert (first.max_std, last.max_std) == (schedule.climb_std, pytest.approx(schedule.finish_std))
    assert (last.entropy, last.crash_cost) == (0.0, pytest.approx(schedule.finish_crash_cost))


def test_a_family_that_never_finds_its_gait_does_not_keep_the_run_from_finishing():
    assert settings_at(CONFIG, spent=0.99, seeking=0.5) == settings_at(CONFIG, spent=0.99, seeking=0.0)
    assert settings_at(CONFIG, spent=0.7, seeking=0.5).max_std == MAX_STD


def test_without_a_finish_the_last_values_are_those_of_the_climb():
    config = replace(CONFIG, schedule=replace(CONFIG.schedule, finish_from=1.0))
    last = settings_at(config, spent=1.0, seeking=0.0)
    assert (last.crash_cost, last.review) == (6.0, 0.25)


def test_physics_steps_are_long_during_the_climb_only():
    config = robust()
    short, long = config.physics.decimation, config.schedule.decimation
    assert long < short
    assert [settings_at(config, spent, seeking=1.0).decimation for spent in (0.1, 0.7, 0.8)] == 3 * [short]
    assert [settings_at(config, spent, seeking=0.0).decimation for spent in (0.1, 0.7, 0.8)] == [long, long, short]


def test_an_actuator_network_keeps_its_own_step():
    config = robust()
    config = replace(config, physics=replace(config.physics, motor="network", motor_file="drive.safetensors"))
    assert {settings_at(config, spent, 0.0).decimation for spent in (0.1, 0.9)} == {config.physics.decimation}


def test_with_calm_gait_there_are_no_pushes_and_new_targets_before_a_gait():
    """Until the gait is found only, and only where the preset asks for it."""
    config = joystick()
    assert settings_at(config, 0.1, seeking=1.0).calm
    assert settings_at(config, 0.1, seeking=0.5).calm
    assert not settings_at(config, 0.1, seeking=0.0).calm
    assert not settings_at(config, 0.9, seeking=1.0).calm
    assert not settings_at(robust(), 0.1, seeking=1.0).calm
