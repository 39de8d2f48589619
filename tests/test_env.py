"""The environment as a whole: everything registered runs, time and crashes end episodes, runs repeat and resume."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from arrive.build import Placement, build_env
from arrive.config import Config, ObservationConfig, RandomisationConfig, TerrainConfig
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.presets import PRESETS, paper, robust
from arrive.task.registry import get_task
from arrive.task.rewards import CRASH_COST, Approach, Cost, PositionRewards, Reward, functions
from arrive.terrain import FAMILIES

CALM = RandomisationConfig(push_speed=0.0, start_yaw_rad=0.0, start_offset=0.0, start_speed=0.0, start_joint_scale=0.0)
MIXED = ("rough", "stairs", "pit", "gap", "obstacles")


def config_of(preset=paper, num_envs: int = 4, families: tuple[str, ...] = ("flat",), **changes) -> Config:
    """A preset made small."""
    terrain = TerrainConfig(families=families, levels=2, variants=2)
    return replace(preset(), num_envs=num_envs, terrain=terrain, **changes)


def settled(config: Config, **placement) -> ArriveEnv:
    """An environment whose robots stay on their level, so that no first episode is shortened."""
    everyone = torch.arange(config.num_envs)
    assignment = (everyone % len(config.terrain.families), torch.zeros_like(everyone))
    return build_env(config, Placement(assignment=assignment, **placement), threads=1)


def rollout(env: ArriveEnv, steps: int, seed: int = 0) -> list[Tensor]:
    """Random actions: everything that a step returns, step by step."""
    generator, seen = torch.Generator().manual_seed(seed), []
    for _ in range(steps):
        observation, reward, done, _ = env.step(torch.randn(env.num_envs, 12, generator=generator))
        seen += [observation[POLICY], reward, done]
    return seen


def same(first: list[Tensor], second: list[Tensor]) -> bool:
    return all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("preset", PRESETS)
def test_every_family_and_preset_runs(preset, family):
    env = build_env(config_of(PRESETS[preset], 6, (family,)), threads=1)
    assert env.get_observations()[POLICY].shape == (6, env.observer.size)
    for values in zip(*[iter(rollout(env, 20))] * 3, strict=True):
        assert [value.shape for value in values] == [(6, env.observer.size), (6,), (6,)]
        assert all(value.isfinite().all() for value in values)
        assert not values[0].requires_grad
        assert set(values[2].tolist()) <= {0, 1}
    assert env.log.diverged == 0
    assert int(env.curriculum.levels.max()) < env.pool.num_levels[0]


def test_the_same_seed_gives_the_same_bits_at_any_number_of_threads():
    torch_threads = torch.get_num_threads()
    runs = []
    try:
        for threads in (1, 2, 2):
            torch.set_num_threads(threads)
            runs.append(rollout(build_env(config_of(robust, 20, MIXED), threads=threads), 120))
    finally:
        torch.set_num_threads(torch_threads)
    assert same(runs[0], runs[1])
    assert same(runs[1], runs[2])
    assert sum(int(done.sum()) for done in runs[0][2::3]) > 5, "episodes must have ended for this to mean much"


def test_another_seed_gives_another_run():
    first, second = (rollout(build_env(config_of(seed=seed), threads=1), 3) for seed in (1, 2))
    assert not torch.equal(first[0], second[0])


@pytest.mark.parametrize("steps", [0, 73])
def test_a_resumed_environment_goes_on_with_the_same_bits(steps):
    env = build_env(config_of(robust, 20, MIXED), threads=1)
    rollout(env, steps)
    saved = env.state_dict()
    expected = rollout(env, 160, seed=1)
    other = build_env(config_of(robust, 20, MIXED), threads=1)
    rollout(other, 11, seed=2)
    other.load_state_dict(saved)
    assert same(rollout(other, 160, seed=1), expected)
    assert torch.equal(other.curriculum.levels, env.curriculum.levels)
    states = other.exploration.state_dict(), env.exploration.state_dict()
    assert all(torch.equal(*(torch.as_tensor(state[name]).nan_to_num() for state in states)) for name in states[0])
    assert sum(int(done.sum()) for done in expected[2::3]) > 5


def test_an_episode_of_the_paper_ends_after_exactly_300_steps():
    env = settled(config_of(randomisation=CALM))
    idle = torch.zeros(4, 12)
    for episode in range(2):
        for step in range(1, 301):
            *_, done, extras = env.step(idle)
            assert done.tolist() == [int(step == 300)] * 4, (episode, step)
            assert env.episode_length_buf.tolist() == [step % 300] * 4
        assert env.log.finished.counted.all()
        assert env.log.finished.failures["stalled"].all()
        assert extras == {}, "a time-out is the end here, not a truncation"


def test_timeouts_are_told_from_crashes_where_they_are_bootstrapped():
    config = config_of(randomisation=CALM)
    env = settled(replace(config, task=get_task("velocity").from_preset(config.task)))
    env.task.command.time_left_s[:] = torch.tensor([0.02, 0.02, 1.0, 1.0])
    overturn(env, torch.tensor([1, 2]))
    *_, done, extras = env.step(torch.zeros(4, 12))
    assert done.tolist() == [1, 1, 1, 0]
    assert extras["time_outs"].tolist() == [1.0, 0.0, 0.0, 0.0]


def overturn(env: ArriveEnv, ids: Tensor, height: float = 0.085, joint_vel: float = 0.0) -> None:
    """Put robots on their backs."""
    qpos = torch.zeros(len(ids), 19, dtype=torch.double)
    qpos[:, 2], qpos[:, 4], qpos[:, 7:] = height, 1.0, torch.tensor(env.robot.default_joint_pos)
    qvel = torch.zeros(len(ids), 18, dtype=torch.double)
    qvel[:, 6:] = joint_vel
    env.physics.reset(ids, qpos, qvel)


def test_a_robot_that_falls_on_its_back_has_crashed_when_it_touches_the_ground():
    env = settled(config_of(robust, randomisation=CALM))
    overturn(env, torch.tensor([1]), height=0.4)
    # The trunk's shell is 0.09 m thick either way: 0.31 m of free fall take 0.25 s, 13 steps.
    ended = []
    for step in range(1, 20):
        _, reward, done, _ = env.step(torch.zeros(4, 12))
        if done.any():
            ended.append((step, done.tolist()))
            assert env.log.finished.failures["crash"].tolist() == [True]
            assert env.log.finished.success.tolist() == [False]
            assert env.log.rewards[CRASH_COST].tolist() == pytest.approx([0.0, -2.0, 0.0, 0.0])
            assert float(reward[1]) < -1.9
    assert len(ended) == 1
    assert ended[0][1] == [0, 1, 0, 0]
    assert 12 <= ended[0][0] <= 14


def test_a_robot_in_a_gap_has_fallen():
    env = settled(config_of(families=("gap",), randomisation=CALM), values=((1.4,),))
    qpos = torch.zeros(1, 19, dtype=torch.double)
    qpos[0, :3], qpos[0, 3] = torch.tensor([1.9, 0.0, -0.45]), 1.0
    qpos[0, 7:] = torch.tensor(env.robot.default_joint_pos)
    env.physics.reset(torch.tensor([2]), qpos, torch.zeros(1, 18, dtype=torch.double))
    done = torch.zeros(4)
    for _ in range(10):
        if not done.any():
            _, _, done, _ = env.step(torch.zeros(4, 12))
    assert done.tolist() == [0, 0, 1, 0]
    assert env.log.finished.failures["fell"].tolist() == [True]
    assert env.log.finished.failures["crash"].tolist() == [False]


@pytest.mark.parametrize("preset", PRESETS)
def test_each_reward_is_logged_by_name_and_their_sum_is_paid(preset):
    config = config_of(PRESETS[preset])
    env = build_env(config, threads=1)
    rewards = config.task.rewards
    paid = {name for name in functions(rewards) if getattr(rewards, name).weight}
    for step in range(60):
        _, reward, _ = rollout(env, 1, seed=step)
        assert set(env.log.rewards) == paid
        total = sum(value.double() for value in env.log.rewards.values())
        torch.testing.assert_close(reward.double(), total, atol=1e-6, rtol=1e-5)
        for name, value in env.log.rewards.items():
            assert not name.endswith("_cost") or bool((value <= 0).all())


def test_rewards_are_rates_times_the_weight_and_the_time_step():
    config = config_of(randomisation=CALM, observation=ObservationConfig(noise=False))
    env = settled(
        replace(
            config, task=replace(config.task, rewards=PositionRewards(action_rate_cost=Cost(-0.01), task=Reward(10.0)))
        )
    )
    env.task.command.time_left_s[:] = 0.5
    env.step(torch.zeros(4, 12))
    action = torch.zeros(4, 12)
    action[1, :3] = torch.tensor([1.0, -2.0, 2.0])
    env.step(action)
    assert env.log.rewards["action_rate_cost"].tolist() == pytest.approx([0.0, -0.01 * 9.0 * 0.02, 0.0, 0.0])
    distance_sq = (env.task.command.target_w - env.state.base_pos_w).square().sum(-1)
    torch.testing.assert_close(env.log.rewards["task"], 10.0 * 0.02 / (1.0 + distance_sq))


def test_the_exploration_reward_goes_with_the_switch_and_no_other_does():
    weights = PositionRewards(exploration=Reward(1.0), approach=Approach(1.0), action_rate_cost=Cost(-0.01))
    config = config_of()
    first, second = (settled(replace(config, task=replace(config.task, rewards=weights))) for _ in range(2))
    second.exploration.active[:] = False
    for env in (first, second):
        rollout(env, 1)
    for name, share in (("exploration", 0.0), ("approach", 1.0), ("action_rate_cost", 1.0)):
        assert first.log.rewards[name].any()
        torch.testing.assert_close(second.log.rewards[name], share * first.log.rewards[name])


def test_the_first_step_of_an_episode_has_no_velocity_differences_to_the_previous_one():
    """Accelerations are differences over a step: across a reset they would be penalised, and huge."""
    env = settled(config_of(randomisation=CALM))
    overturn(env, torch.arange(4), joint_vel=6.0)
    env.step(torch.ones(4, 12))
    assert (env.log.rewards["joint_acc_cost"] < -1e-4).all()
    assert env.episode_length_buf.tolist() == [0] * 4
    env.step(torch.zeros(4, 12))
    # In the air at the default pose and at rest nothing but free fall happens in the first step.
    assert float(env.state.joint_acc.abs().max()) < 20.0
    assert not env.state.foot_acc_w.any()
    assert not env.state.previous_action.any()


def test_pushes_come_at_the_configured_rate_and_speed():
    randomisation = replace(CALM, push_speed=0.8, push_interval_s=0.5)
    env = settled(config_of(num_envs=100, randomisation=randomisation))
    pushes = []
    apply = env.physics.push

    def record(ids: Tensor, velocity: Tensor) -> None:
        pushes.append(velocity)
        apply(ids, velocity)

    env.physics.push = record
    for _ in range(20):
        env.step(torch.zeros(100, 12))
    velocity = torch.cat(pushes)
    # 2000 robot steps of 0.02 s at one push in 0.5 s: 80, within four standard deviations.
    assert abs(len(velocity) - 80) < 4 * 80**0.5
    assert not velocity[:, 2].any()
    assert 0.7 < float(velocity[:, :2].abs().max()) <= 0.8
    assert float(velocity[:, :2].mean(0).abs().max()) < 4 * 0.8 / (3 * len(velocity)) ** 0.5


def test_a_calm_environment_has_neither_pushes_nor_new_targets():
    config = config_of(robust, 20, randomisation=replace(CALM, push_speed=0.5, push_interval_s=0.1))
    env = build_env(replace(config, task=replace(config.task, retarget_s=0.1)), threads=1)
    pushed: list[Tensor] = []
    env.physics.push = lambda ids, velocity: pushed.append(ids)
    for calm in (True, False):
        env.calm = calm
        before, ended = env.task.command.target_w.clone(), torch.zeros(20, dtype=torch.bool)
        for _ in range(10):
            ended |= env.step(torch.zeros(20, 12))[2].bool()
        moved = (env.task.command.target_w != before).any(-1) & ~ended
        assert bool(moved.any()) is bool(pushed) is not calm


def test_a_push_is_seen_at_once():
    randomisation = replace(CALM, push_speed=1.0, push_interval_s=0.02)
    env = settled(config_of(randomisation=randomisation, observation=ObservationConfig(noise=False)))
    observation, *_ = env.step(torch.zeros(4, 12))
    # Robots look along x and are still upright; the policy receives twice the velocity.
    seen, velocity = observation[POLICY][:, :2] / 2.0, env.physics.read().base_lin_vel_w[:, :2]
    assert float(velocity.abs().max()) > 0.5
    torch.testing.assert_close(seen, velocity, atol=0.02, rtol=0.0)


def test_robots_are_distributed_equally_over_the_families():
    env = build_env(config_of(num_envs=11, families=MIXED), threads=1)
    assert torch.bincount(env.family_of_env).tolist() == [3, 2, 2, 2, 2]
    for i in range(11):
        assert int(env.tile_of_env[i]) in env.pool.tile_of_world[env.pool.world_index[env.family_of_env[i]]]


def test_levels_follow_what_robots_do():
    """Who is at its target goes up, who is far from it goes down, and whose target is on this side does neither."""
    env = build_env(config_of(num_envs=6, families=("pit",), randomisation=CALM), threads=1)
    while bool(env.memory.shortened.any()):
        env.task.command.time_left_s[:] = 0.02
        env.step(torch.zeros(6, 12))
    env.curriculum.levels[:] = torch.tensor([0, 1, 0, 1, 0, 1])
    env.memory.level.copy_(env.curriculum.levels)
    command = env.task.command
    command.crossing[:] = torch.tensor([True, True, True, True, False, False])
    command.target_w[:] = torch.tensor([0.0, 0.0, 0.55])
    command.target_w[[1, 2, 5]] = torch.tensor([4.0, 0.0, 0.55])
    command.time_left_s[:] = 0.02
    env.step(torch.zeros(6, 12))
    finished = env.log.finished
    assert finished.success.tolist() == [True, False, False, True, True, False]
    assert finished.counted.all()
    assert finished.levels.tolist() == [0, 1, 0, 1, 0, 1]
    levels = env.curriculum.levels.tolist()
    assert levels[:3] == [1, 0, 0]
    assert levels[3] in (0, 1), "beyond the last level any of them"
    assert levels[4:] == [0, 1]


def test_robots_that_review_an_easier_level_keep_their_own_and_do_not_count():
    config = config_of(num_envs=40, families=("pit",), randomisation=CALM)
    env = build_env(replace(config, terrain=replace(config.terrain, levels=4)), threads=1)
    env.review = 0.5
    env.start_at_levels({"pit": torch.tensor([0.0, 0.34, 0.67, 1.0])})
    while bool(env.memory.shortened.any()):
        env.task.command.time_left_s[:] = 0.02
        env.step(torch.zeros(40, 12))
    own, played = env.curriculum.levels.clone(), env.memory.level.clone()
    reviewing = played < own
    assert 3 < int(reviewing.sum()) < 37
    assert torch.equal(played[~reviewing], own[~reviewing])
    tiles = env.pool.world_index[0, played]
    assert (env.pool.tile_of_world[tiles] == env.tile_of_env[:, None]).any(1).all(), "they stand on what they play"
    command = env.task.command
    command.crossing[:], command.time_left_s[:] = True, 0.02
    command.target_w[:] = torch.tensor([4.0, 0.0, 0.55])
    env.step(torch.zeros(40, 12))
    assert torch.equal(env.log.finished.counted, ~reviewing)
    assert torch.equal(env.log.finished.levels, played)
    assert torch.equal(env.curriculum.levels, torch.where(reviewing, own, (own - 1).clamp(min=0)))


def test_a_warm_start_draws_from_the_levels_reached_before():
    env = build_env(config_of(num_envs=60, families=("pit", "gap", "flat")), threads=1)
    gap = env.family_of_env == 1
    before = env.curriculum.levels[gap].clone()
    env.start_at_levels({"pit": torch.tensor([0.2, 0.9]), "flat": torch.tensor([0.0]), "stairs": torch.tensor([1.0])})
    pits = env.curriculum.levels[env.family_of_env == 0]
    assert pits.unique().tolist() == [0, 1], "of two levels the nearest"
    assert torch.equal(env.curriculum.levels[gap], before)
    assert torch.equal(env.memory.level, env.curriculum.levels)
    assert env.memory.shortened.all()


def test_shortened_episodes_change_no_level():
    env = build_env(config_of(num_envs=6, families=("pit",), randomisation=CALM), threads=1)
    levels = env.curriculum.levels.clone()
    env.task.command.time_left_s[:], env.task.command.crossing[:] = 0.02, True
    env.step(torch.zeros(6, 12))
    assert not env.log.finished.counted.any()
    assert torch.equal(env.curriculum.levels, levels)


@pytest.mark.parametrize("num_envs", [0, -3])
def test_no_robots_are_an_error(num_envs):
    with pytest.raises(ArriveError, match=rf"num_envs must be .*, not {num_envs}"):
        build_env(config_of(num_envs=num_envs))


def test_fewer_robots_than_families_are_an_error():
    with pytest.raises(ArriveError, match="num_envs must be at least the number of terrain families, 5, not 4"):
        build_env(config_of(num_envs=4, families=MIXED))


def test_unknown_names_are_errors_that_list_the_valid_ones():
    config = config_of()
    for changed in (
        replace(config, terrain=replace(config.terrain, families=("fla",))),
        replace(config, robot="anymal"),
    ):
        with pytest.raises(ArriveError, match=r"unknown .* Valid: "):
            build_env(changed)
