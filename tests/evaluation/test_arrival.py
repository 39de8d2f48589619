"""Evaluation: every episode counts once, on its terrain, and is repeatable."""

import dataclasses
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch

from arrive.build import build_env
from arrive.config import Config, override
from arrive.errors import ArriveError
from arrive.evaluation import arrival, playing
from arrive.evaluation.arrival import Arrival, Cell, cells_of, evaluate
from arrive.learning.policy import Policy
from arrive.presets import get_preset
from arrive.terrain import get_family
from arrive.terrain.levels import EVALUATION_SEED_OFFSET

CONFIG = override(
    get_preset("paper"),
    (
        "num_envs=4",
        "task.episode_s=0.4",
        "task.episode_min_s=0.2",
        "task.reward_window_s=0.2",
        "task.target_distance=[1, 2]",
        "terrain.levels=3",
        "terrain.variants=2",
    ),
)
EPISODES = 5


def standing(config: Config) -> Policy:
    """A policy that holds the default pose."""
    return scripted(config, lambda observation: torch.zeros(len(observation), 12))


def scripted(config: Config, act) -> Policy:
    schema = build_env(config, threads=1).observer.schema()
    return Policy(Path("scripted"), config, schema, "none", 0, lambda observations: act(observations["policy"]))


def measure(config: Config = CONFIG, families=("flat", "pit", "rough"), seed: int = 1, **options) -> Arrival:
    policy = options.pop("policy", None) or standing(config)
    cells = cells_of(config, [get_family(name) for name in families], options.pop("level", None))
    return evaluate(policy, cells, options.pop("episodes", EPISODES), seed, options.pop("threads", 1), **options)


def figures(answer: Arrival) -> list[tuple]:
    return [(r.cell.caption, r.episodes, r.arrived, r.median_distance, r.failures) for r in answer.results]


def test_there_is_a_cell_for_every_level_of_every_family():
    pit = get_family("pit")
    cells = cells_of(CONFIG, [get_family("flat"), pit], None)
    middle = (pit.lowest + pit.highest) / 2
    expected = [("flat", 0), ("pit", 0), ("pit", 1), ("pit", 2)]
    assert [(cell.family.name, cell.level) for cell in cells] == expected
    assert [cell.value for cell in cells[1:]] == pytest.approx([pit.lowest, middle, pit.highest])
    assert cells_of(CONFIG, [pit], 1) == [Cell(pit, 1, cells[2].value)]
    assert cells[2].caption == f"pit {middle:.2f} m"
    assert cells[0].caption == "flat"


@pytest.mark.parametrize("level", [-1, 3])
def test_a_level_out_of_range_names_the_range(level):
    with pytest.raises(ArriveError, match=r"level -?\d of pit is out of range: levels are 0 to 2"):
        cells_of(CONFIG, [get_family("pit")], level)


@pytest.mark.parametrize("episodes", [0, -1])
def test_no_episodes_is_an_error(episodes):
    with pytest.raises(ArriveError, match="episodes must be at least 1"):
        measure(episodes=episodes)


def test_arrivals_and_failures_add_up_in_every_cell():
    answer = measure()
    assert [r.cell.caption for r in answer.results] == [e.caption for e in answer.episodes]
    assert len(answer.results) == 7
    for result in answer.results:
        assert result.episodes == EPISODES
        assert result.arrived + sum(result.failures.values()) == EPISODES
        assert all(count > 0 for count in result.failures.values())
        assert result.interval[0] <= result.success <= result.interval[1]


def test_all_robots_arrive_with_a_huge_arrival_radius_and_none_with_a_tiny_one():
    near = measure(override(CONFIG, ("task.arrival_radius=50",)), ["flat"], episodes=20).results[0]
    assert near.arrived + near.failures.get("crash", 0) == 20
    assert near.arrived >= 15
    far = measure(override(CONFIG, ("task.arrival_radius=0.01",)), ["flat"], episodes=20).results[0]
    assert far.arrived == 0
    assert sum(far.failures.values()) == 20
    assert far.failures.get("crash", 0) == near.failures.get("crash", 0)


def test_the_median_distance_is_that_of_robots_that_stay_where_they_started():
    result = measure(override(CONFIG, ("task.target_distance=[3, 3.001]",)), ["flat"], episodes=15).results[0]
    assert result.median_distance == pytest.approx(3.0, abs=0.25)


def test_a_policy_that_falls_over_crashes():
    config = override(CONFIG, ("task.episode_s=2",))
    wild = scripted(config, lambda observation: torch.full((len(observation), 12), 6.0))
    result = measure(config, ["flat"], episodes=10, policy=wild).results[0]
    assert result.failures.get("crash", 0) >= 5


def test_the_same_seed_gives_the_same_result_at_any_number_of_threads():
    policy = standing(CONFIG)
    first = measure(policy=policy, threads=1)
    assert figures(measure(policy=policy, threads=1)) == figures(first)
    double = measure(policy=policy, threads=2)
    assert figures(double) == figures(first)
    for one, two in zip(first.episodes, double.episodes, strict=True):
        assert one.outcome == two.outcome
        np.testing.assert_array_equal(one.qpos, two.qpos)
    other = measure(policy=policy, seed=2)
    distances = [(a.median_distance, b.median_distance) for a, b in zip(first.results, other.results, strict=True)]
    assert all(a != b for a, b in distances)


def test_the_policy_acts_without_exploration_and_changes_no_global_randomness():
    torch.manual_seed(5)
    before = torch.get_rng_state()
    measure(families=["flat"])
    assert torch.equal(torch.get_rng_state(), before)


class Watch:
    """Notes what an evaluation's environments do, through the functions that it calls."""

    def __init__(self, monkeypatch):
        self.configs, self.placements, self.envs, self.played = [], [], [], []
        self.ended: list[Counter] = []
        self.counted: list[bool] = []
        build, note, play = arrival.build_env, playing._note_ended, arrival.play

        def building(config, placement, threads):
            env = build(config, placement, threads)
            self.configs.append(config)
            self.placements.append(placement)
            self.envs.append(env)
            self.ended.append(Counter())
            return env

        def noting(env, played, waiting, step):
            if env.log.finished is not None:
                mine = waiting[env.log.finished.env_ids].clone()
                self.ended[-1].update(env.log.finished.env_ids[mine].tolist())
                self.counted += env.log.finished.counted[mine].tolist()
            note(env, played, waiting, step)

        def playing_(*args):
            self.played.append(play(*args))
            return self.played[-1]

        monkeypatch.setattr(arrival, "build_env", building)
        monkeypatch.setattr(playing, "_note_ended", noting)
        monkeypatch.setattr(arrival, "play", playing_)


@pytest.mark.parametrize("at_a_time", [1000, 6])
def test_every_robot_plays_one_counted_episode_on_its_own_terrain(monkeypatch, at_a_time):
    """Also where the robots do not all fit at a time, so that a part begins within a cell."""
    watch = Watch(monkeypatch)
    monkeypatch.setattr(arrival, "MAX_ENVS", at_a_time)
    answer = measure(families=("pit", "stairs", "flat"))
    expected = [c.cell for c in answer.results for _ in range(EPISODES)]
    assert sum(env.num_envs for env in watch.envs) == len(expected) == 7 * EPISODES
    dealt = iter(expected)
    for env, played, ended in zip(watch.envs, watch.played, watch.ended, strict=True):
        assert ended == Counter(range(env.num_envs)), "one episode each"
        assert ((played.steps >= 1) & (played.steps <= 20)).all()
        for env_id, cell in zip(range(env.num_envs), dealt, strict=False):
            family, level = int(env.family_of_env[env_id]), int(env.curriculum.levels[env_id])
            assert env.pool.families[family].name == cell.family.name
            assert env.pool.values[family][level] == pytest.approx(cell.value)
            worlds = env.pool.world_index[family, level]
            assert int(played.tile[env_id]) in env.pool.tile_of_world[worlds].tolist()
    assert next(dealt, None) is None
    assert all(watch.counted), "no shortened first episodes"
    assert len(watch.counted) == len(expected)
    assert [r.episodes for r in answer.results] == [EPISODES] * 7
    assert [e.caption for e in answer.episodes] == [r.cell.caption for r in answer.results]


def test_episodes_have_the_full_length_and_terrain_that_training_did_not_see(monkeypatch):
    watch = Watch(monkeypatch)
    asked = override(CONFIG, ("task.arrival_radius=50",))
    measure(asked, ["flat"], episodes=10)
    (played,), (config,), (placement,) = watch.played, watch.configs, watch.placements
    assert (played.steps[played.success] == 20).all()
    assert played.success.any()
    assert placement.seed_offset == EVALUATION_SEED_OFFSET
    assert config.task == dataclasses.replace(asked.task, episode_min_s=asked.task.episode_s)
    for part in ("observation", "randomisation", "physics", "robot"):
        assert getattr(config, part) == getattr(asked, part)


def test_recorded_episodes_begin_at_the_start_and_end_before_the_reset():
    answer = measure(override(CONFIG, ("randomisation.start_offset=0",)), ["flat", "pit"])
    for episode in answer.episodes:
        assert 1 <= len(episode.qpos) <= 20
        assert episode.qpos.shape[1] == 19
        np.testing.assert_allclose(episode.qpos[0, :2], 0.0, atol=1e-6)
        steps = np.linalg.norm(np.diff(episode.qpos[:, :3], axis=0), axis=1)
        assert (steps < 0.1).all(), "a jump: the robot was put back to the start within the record"
        assert math.isfinite(sum(episode.target_w))


def test_the_progress_reaches_its_end(monkeypatch):
    monkeypatch.setattr(arrival, "MAX_ENVS", 4)
    told = []
    measure(families=["flat", "pit"], level=0, episodes=4, progress=lambda *counts: told.append(counts))
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert told[-1][1] == 40
    assert all(done <= total for done, total in told)


def test_a_policy_of_another_observation_is_refused():
    policy = standing(override(CONFIG, ("observation.heights.step=0.2",)))
    foreign = dataclasses.replace(policy, config=CONFIG)
    with pytest.raises(ArriveError, match="another observation"):
        measure(policy=foreign)
