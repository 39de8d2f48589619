"""Gymnasium: every id runs, its own checks pass, and episodes end as its specification says."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils import env_checker
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from arrive.errors import ArriveError
from arrive.gym import environment_id
from arrive.render.graphics import GraphicsUnavailable, graphics_backend
from arrive.terrain import FAMILIES

SMALL = ("terrain.levels=2", "terrain.variants=1")
SHORT = (*SMALL, "task.episode_s=0.4", "task.episode_min_s=0.4", "task.reward_window_s=0.2")


def make(id: str = "arrive/Flat-v0", num_envs: int = 4, overrides=SMALL, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return gymnasium.make_vec(id, num_envs=num_envs, overrides=overrides, threads=1, **options)


def rollout(envs, steps: int, scale: float = 0.3) -> list:
    """Random actions, the same ones each time; everything that reset and the steps return."""
    rng = np.random.default_rng(0)
    return [envs.step(scale * rng.standard_normal(envs.action_space.shape)) for _ in range(steps)]


def test_importing_arrive_imports_no_gymnasium_and_registering_no_torch():
    program = (
        "import sys, arrive\n"
        "assert 'gymnasium' not in sys.modules\n"
        "import gymnasium, arrive.gym\n"
        "gymnasium.register_envs(arrive.gym)\n"
        "assert 'arrive/StairsDown-v0' in gymnasium.registry\n"
        "assert 'torch' not in sys.modules\n"
    )
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0


@pytest.mark.parametrize("family", [*FAMILIES, "all"])
def test_every_id_runs(family):
    envs = make(environment_id(family), num_envs=len(FAMILIES), overrides=SHORT)
    observations, info = envs.reset(seed=1)
    assert observations in envs.observation_space
    assert info == {}
    ends = 0
    for observations, rewards, terminations, truncations, _ in rollout(envs, 25):
        assert observations in envs.observation_space
        assert observations.dtype == rewards.dtype == np.float32
        assert rewards.shape == terminations.shape == truncations.shape == (len(FAMILIES),)
        assert np.isfinite(rewards).all()
        ends += terminations.sum()
    assert ends >= len(FAMILIES)
    envs.close()
    assert envs.closed


@pytest.mark.parametrize("task", ["final", "velocity"])
def test_gymnasiums_own_checks_pass(task):
    """Those of `check_env` that do not ask for a single environment's Python bool."""
    envs = make(num_envs=1, task=task)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env_checker.check_reset_seed_determinism(envs)
        env_checker.check_reset_options(envs)
        env_checker.check_reset_return_type(envs)
        env_checker.check_returned_data_not_reused(envs)


@pytest.mark.parametrize("id", ["arrive/All-v0", "arrive/Rough-v0"])
def test_a_seed_repeats_everything_bit_by_bit(id):
    envs = make(id, num_envs=10, overrides=SHORT)
    runs = []
    for seed in (5, 5, 6):
        first = envs.reset(seed=seed)
        runs.append([first, *rollout(envs, 40, scale=1.0)])
    assert env_checker.data_equivalence(runs[0], runs[1], exact=True)
    assert not env_checker.data_equivalence(runs[0][0], runs[2][0])


def test_a_reset_with_a_seed_equals_a_new_environment():
    env = make("arrive/Rough-v0", overrides=SHORT).unwrapped._env
    first = env.get_observations()["policy"]
    for _ in range(30):
        env.step(torch.ones(4, 12))
    env.restart(seed=env.config.seed)
    torch.testing.assert_close(env.get_observations()["policy"], first, rtol=0, atol=0)


def test_the_last_observation_is_the_old_episodes():
    """The same robots given more time go on where the others end, and tell what the last observation must be."""
    overrides = ("observation.noise=false", "randomisation.push_speed=0", *SHORT)
    ending, going_on = (make("arrive/Rough-v0", level=1, overrides=overrides) for _ in range(2))
    for envs in (ending, going_on):
        envs.reset(seed=3)
    going_on.unwrapped._env.task.command.time_left_s += 1.0
    for first, second in zip(rollout(ending, 20), rollout(going_on, 20), strict=True):
        (now, _, ended, _, info), (expected, _, too_early, *_) = first, second
        assert not too_early.any()
    assert ended.all()
    last, time_left = np.stack(info["final_obs"]), 12
    np.testing.assert_array_equal(np.delete(last, time_left, 1), np.delete(expected, time_left, 1))
    np.testing.assert_allclose(last[:, time_left], 0.0, atol=1e-5)
    assert (np.abs(now - last).max(1) > 0.1).all()


class Toy(gymnasium.Env):
    """Ends after two steps with the infos that ours have."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return np.zeros(3, dtype=np.float32), {}

    def step(self, action):
        self.steps += 1
        ended = self.steps == 2
        final = {"is_success": True, "level": np.int64(0), "distance": np.float32(0.2), "failure": ""}
        return np.ones(3, dtype=np.float32), 0.0, ended, False, final if ended else {}


def layout(info: dict) -> dict:
    """Names, types and shapes."""
    return {
        name: layout(value) if isinstance(value, dict) else (value.dtype, value.shape) for name, value in info.items()
    }


def test_infos_are_laid_out_as_gymnasiums_own_vector_environments_do():
    envs = make(num_envs=2, level=0, overrides=SHORT)
    envs.reset(seed=1)
    toys = SyncVectorEnv([Toy, Toy], autoreset_mode=AutoresetMode.SAME_STEP)
    toys.reset()
    toys.step(np.zeros((2, 1)))
    expected = toys.step(np.zeros((2, 1)))[4]
    *before, (_, _, ended, _, info) = rollout(envs, 20)
    assert ended.all()
    assert all(step[4] == {} for step in before)
    assert layout(info) == layout(expected)
    assert info["final_obs"][0].shape == envs.single_observation_space.shape
    assert info["final_obs"][0].dtype == np.float32


def test_a_crash_terminates_with_its_cause_and_only_there():
    envs = make(num_envs=8, level=0)
    envs.reset(seed=1)
    folded = np.tile([0.0, 3.0, -5.0, 0.0, -3.0, 5.0], (8, 2))
    crashes = 0
    for _ in range(80):
        _, _, terminations, truncations, info = envs.step(folded)
        assert not truncations.any()
        if terminations.any():
            np.testing.assert_array_equal(info["_final_obs"], terminations)
            assert [obs is not None for obs in info["final_obs"]] == terminations.tolist()
            assert set(info["final_info"]["failure"][terminations]) == {"crash"}
            assert not info["final_info"]["is_success"].any()
            crashes += terminations.sum()
    assert crashes >= 8


@pytest.mark.parametrize(("task", "truncates"), [("final", False), ("continuous", False), ("velocity", True)])
def test_the_end_of_time_truncates_only_where_time_is_not_observed(task, truncates):
    shorter = {"final": ("episode_min_s", "reward_window_s"), "continuous": ("episode_min_s",), "velocity": ()}[task]
    overrides = (*SMALL, "task.episode_s=0.4", *(f"task.{name}=0.4" for name in shorter))
    envs = make(num_envs=2, level=0, task=task, overrides=overrides)
    envs.reset(seed=2)
    *_, (_, _, terminations, truncations, _) = rollout(envs, 20, scale=0.0)
    assert truncations.tolist() == [truncates] * 2
    assert terminations.tolist() == [not truncates] * 2


def test_gymnasiums_wrappers_fit():
    envs = DictInfoToList(RecordEpisodeStatistics(make(num_envs=2, level=0, overrides=SHORT)))
    envs.reset(seed=1)
    for _ in range(20):
        *_, infos = envs.step(np.zeros((2, 12)))
    assert [info["episode"]["l"] for info in infos] == [20, 20]
    assert infos[0]["final_info"]["failure"] in ("", "late", "stalled", "wrong_side")


def test_levels_are_fixed_if_given_and_follow_success_otherwise():
    fixed = make("arrive/All-v0", num_envs=10, level=1, overrides=SHORT)
    fixed.reset(seed=1)
    has_levels = [family.lowest != family.highest for family in FAMILIES.values()]
    ended = [step[4]["final_info"] for step in rollout(fixed, 40) if step[4]]
    assert len(ended) >= 2
    for info in ended:
        np.testing.assert_array_equal(info["level"][info["_level"]], np.array(has_levels)[info["_level"]])
    following = make("arrive/Stairs-v0", num_envs=16, overrides=(*SHORT, "task.arrival_radius=9"))
    following.reset(seed=1)
    levels = [step[4]["final_info"]["level"].max() for step in rollout(following, 80, scale=0.0) if step[4]]
    assert levels[0] == 0
    assert max(levels) == 1


def test_wrong_arguments_are_named():
    for mistake, part in (
        ({"level": 2}, "levels are 0 to 1"),
        ({"preset": "moon"}, "unknown preset"),
        ({"task": "fly"}, "unknown task"),
        ({"overrides": ("ppo.gama=1",)}, "gamma"),
        ({"num_envs": 0}, "num_envs"),
        ({"render_mode": "human"}, "render_mode"),
        ({"autoreset_mode": "Disabled"}, "NEXT_STEP"),
    ):
        with pytest.raises(ArriveError, match=part):
            make(**mistake)
    envs = make()
    envs.reset(seed=1)
    for actions, part in (
        (np.zeros((3, 12)), r"\(4, 12\).*\(3, 12\)"),
        (np.full((4, 12), np.nan), "48 of 48 are not finite"),
    ):
        with pytest.raises(ArriveError, match=part):
            envs.step(actions)
    with pytest.raises(ArriveError, match="no options"):
        envs.reset(options={"reset_mask": np.ones(4, dtype=bool)})


def test_ends_are_shown_at_once_and_starts_in_the_next_step():
    """As `SyncVectorEnv` does with `NEXT_STEP`, which wrappers of Gymnasium rely on."""
    same, later = (
        make(num_envs=3, level=0, overrides=SHORT, autoreset_mode=mode) for mode in ("SAME_STEP", "NextStep")
    )
    assert later.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    starts = [envs.reset(seed=4)[0] for envs in (same, later)]
    np.testing.assert_array_equal(*starts)
    for first, second in zip(rollout(same, 20), rollout(later, 20), strict=True):
        np.testing.assert_array_equal(first[1], second[1])
        ended = first[2]
    assert ended.all()
    assert second[2].all()
    np.testing.assert_array_equal(np.stack(first[4]["final_obs"]), second[0])
    assert layout(second[4]) == layout(first[4]["final_info"])
    observations, rewards, terminated, truncated, info = later.step(np.ones((3, 12)))
    assert not rewards.any()
    assert not terminated.any()
    assert not truncated.any()
    assert info == {}
    assert (later.unwrapped._env.episode_length_buf == 0).all(), "the step only starts the episode"
    joints, command = slice(13, 25), 12
    assert (np.abs(observations - second[0])[:, joints].max(1) > 0.01).all()
    assert (observations[:, command] > second[0][:, command]).all(), "time left"


def test_an_episode_with_next_step_is_as_long_as_with_same_step():
    envs = make(num_envs=2, level=0, overrides=SHORT, autoreset_mode=AutoresetMode.NEXT_STEP)
    envs.reset(seed=1)
    ends = [step[2].all() for step in rollout(envs, 62)]
    assert [step + 1 for step, end in enumerate(ends) if end] == [20, 41, 62]


def single(**options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return gymnasium.make("arrive/Flat-v0", overrides=SHORT, threads=1, **options)


def test_a_single_environment_passes_gymnasiums_checks():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Both spaces are in the policy's own units.
        warnings.filterwarnings("ignore", "(?s).*(normalized space|infinity)")
        env_checker.check_env(single(level=0).unwrapped, skip_render_check=True)


def test_a_single_environment_ends_with_its_result():
    env = single()
    for seed in (3, None):  # levels follow success, and no episode is a shortened one
        env.reset(seed=seed)
        steps = [env.step(np.zeros(12)) for _ in range(20)]
        assert [step[2] for step in steps] == [False] * 19 + [True]
        assert set(steps[-1][4]) == {"is_success", "level", "distance", "failure"}
    with pytest.raises(ArriveError, match="call reset"):
        env.step(np.zeros(12))
    env.reset()
    for action in (np.zeros((1, 12)), "x"):
        with pytest.raises(ArriveError, match=r"must be \(12,\) finite"):
            env.step(action)


def test_bounds_of_actions_are_finite():
    env = single()
    assert np.isfinite(env.action_space.high).all()
    assert (env.action_space.low == -env.action_space.high).all()
    assert env.action_space.high * env.unwrapped._robots._env.robot.action_scale == pytest.approx(np.full(12, np.pi))


def test_pictures_follow_the_robots():
    try:
        graphics_backend()
    except GraphicsUnavailable:
        pytest.skip("this machine cannot draw")
    env = single(render_mode="rgb_array", level=0)
    env.reset(seed=1)
    first = env.render()
    assert first.shape == (432, 768, 3)
    assert first.dtype == np.uint8
    for _ in range(15):
        env.step(np.full(12, 1.0))
    assert np.abs(env.render().astype(int) - first).mean() > 1.0
    env.close()
    envs = make("arrive/Stairs-v0", num_envs=2, render_mode="rgb_array")
    envs.reset(seed=1)
    assert [picture.shape for picture in envs.render()] == [(432, 768, 3)] * 2
    envs.close()
    assert make().render() is None


def test_stable_baselines_trains():
    sb3 = pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
    from arrive.gym.sb3 import StableBaselinesEnv

    envs = StableBaselinesEnv(4, terrain="flat", overrides=SHORT, threads=1)
    model = sb3.PPO("MlpPolicy", envs, n_steps=32, batch_size=64, n_epochs=1, seed=1, device="cpu")
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(256)
    assert model.num_timesteps == 256
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters(), strict=True))
    assert len(model.ep_success_buffer) >= 8, "results of episodes are logged"


def test_stable_baselines_gets_the_last_observation_of_an_episode():
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
    from arrive.gym.sb3 import StableBaselinesEnv

    ours = make(num_envs=2, level=0, task="velocity", overrides=(*SMALL, "task.episode_s=0.4"))
    theirs = StableBaselinesEnv(2, level=0, task="velocity", overrides=(*SMALL, "task.episode_s=0.4"), threads=1)
    theirs.seed(7)
    np.testing.assert_array_equal(ours.reset(seed=7)[0], theirs.reset())
    for _ in range(20):
        observations, _, _, truncated, info = ours.step(np.zeros((2, 12)))
        observed, _, dones, infos = theirs.step(np.zeros((2, 12)))
    np.testing.assert_array_equal(observations, observed)
    assert truncated.all()
    assert dones.all()
    for robot, told in enumerate(infos):
        assert told["TimeLimit.truncated"]
        np.testing.assert_array_equal(told["terminal_observation"], info["final_obs"][robot])


def test_numbers_of_any_kind_are_actions():
    """Bools, integers, doubles, other memory layouts: all are the same actions."""
    envs = make()
    ones = np.ones(envs.action_space.shape)
    locked = ones.astype(np.float32)
    locked.setflags(write=False)
    results = []
    for actions in (ones, ones.astype(int), ones.astype(bool), ones.tolist(), locked, np.tile(ones, 2)[:, ::-2]):
        envs.reset(seed=1)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            results.append(envs.step(actions)[0])
    assert all(np.array_equal(result, results[0]) for result in results)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda a: "x", "must be"),
        (lambda a: [[1.0], [1.0, 2.0]], "finite numbers: "),
        (lambda a: a + 1j, "must be .* numbers, not complex128"),
        (lambda a: a.astype(str), "must be .* numbers, not <U"),
        (lambda a: np.ma.masked_array(a, mask=True), "masked entries"),
        (lambda a: a * 1e300 + 1e300, "48 of 48 are not finite"),
        (lambda a: a.T, r"must be \(4, 12\) finite numbers, not float64 \(12, 4\)"),
        (lambda a: None, "must be"),
    ],
)
def test_what_is_no_action_is_refused(spoil, message):
    envs = make()
    envs.reset(seed=1)
    with pytest.raises(ArriveError, match=message):
        envs.step(spoil(np.zeros(envs.action_space.shape)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": True}, "level True is out of range"),
        ({"level": 0.5}, "level 0.5 is out of range"),
        ({"level": "1"}, "level '1' is out of range"),
        ({"threads": -1}, "--threads must be 0 to"),
        ({"threads": 10**6}, "--threads must be 0 to"),
    ],
)
def test_options_that_cannot_be_meant_are_refused(options, message):
    with pytest.raises(ArriveError, match=message):
        gymnasium.make_vec("arrive/Flat-v0", **{"num_envs": 2, "threads": 1, **options})


def test_a_closed_environment_stays_closed():
    envs = make()
    envs.reset(seed=1)
    envs.close()
    envs.close()
    for call in (envs.reset, lambda: envs.step(np.zeros(envs.action_space.shape))):
        with pytest.raises(ArriveError, match="closed"):
            call()
