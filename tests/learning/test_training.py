"""Training: repeatable, continued exactly after a kill, never learning from NaN."""

import math
import signal
import subprocess
import sys
import time

import pytest
import torch
from torch import Tensor

from arrive import cli
from arrive.build import build_env
from arrive.commands.policies import read_policy
from arrive.config import override
from arrive.deployment.export import export_policy
from arrive.env import POLICY, Finished
from arrive.errors import ArriveError
from arrive.learning.policy import LOG_STD, load_policy
from arrive.learning.trainer import Budget, Trainer
from arrive.presets import get_preset
from arrive.startup import INTERRUPTED
from arrive.task.final import FinalPositionTask
from arrive.terrain import FAMILIES
from training_runs import (
    NUM_ENVS,
    SMALL,
    STEPS,
    arguments,
    differing,
    leaves,
    log_rows,
    make_trainer,
    run,
    saved_state,
    train,
)

ALL_ITERATIONS = 20
FAMILY_ITERATIONS = 2


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


# Repeatable.


def test_two_runs_with_one_seed_are_identical(tmp_path):
    first = train("flat,pit", tmp_path / "a", 5)
    second = train("flat,pit", tmp_path / "b", 5)
    assert differing(first, second) == []
    assert log_rows(tmp_path / "a") == log_rows(tmp_path / "b")
    assert len(log_rows(tmp_path / "a")) == 5
    other = train("flat,pit", tmp_path / "c", 5, seed=2)
    apart = differing(first, other)
    assert any("actor_state_dict" in name for name in apart)
    assert any("physics/qpos" in name for name in apart)


# Continued.

KILLED = """
import sys
from arrive import cli
from arrive.learning.trainer import Trainer
plain = Trainer.train
Trainer.train = lambda *arguments: plain(*arguments, save_interval_s=0.0)
cli.main(sys.argv[1:])
"""


def start(folder, program: list[str], iterations: int = 100_000) -> subprocess.Popen:
    options = ("--num-envs", NUM_ENVS, "--iterations", iterations, "--out", folder, "--set", *SMALL)
    command = [sys.executable, *program, *arguments("flat,pit", *options)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for_rows(process: subprocess.Popen, folder, rows: int) -> None:
    path, deadline = folder / "log.csv", time.monotonic() + 240
    while not path.exists() or path.read_text().count("\n") <= rows:
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_killed_run_goes_on_as_if_nothing_had_happened(tmp_path):
    """SIGKILL at any moment after some checkpoints, then resumed: all the same bits as a run that was left alone."""
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    process = start(killed, ["-c", KILLED])
    try:
        wait_for_rows(process, killed, 4)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    done = saved_state(killed)["iteration"]
    assert done >= 3
    cli.main(arguments("flat,pit", "--resume", killed, "--iterations", 2 * done))
    resumed = saved_state(killed)
    assert resumed["iteration"] == 2 * done
    uninterrupted = train("flat,pit", whole, 2 * done)
    assert differing(resumed, uninterrupted) == []
    assert log_rows(killed) == log_rows(whole)
    covered = leaves(resumed)
    for part in ("actor_state_dict", "optimizer_state_dict", "levels", "exploration", "random", "physics/qpos"):
        assert any(part in name for name in covered), f"the comparison does not look at {part}"


@pytest.mark.parametrize("split", [1, 4])
def test_every_part_of_the_state_is_restored(tmp_path, split):
    """As above without the command line, on terrain where levels move and with everything switched on."""
    settings = (
        "ppo.symmetry=true",
        "task.arrival_radius=2.5",
    )
    terrain = '["flat", "stairs", "rough"]'
    whole = make_trainer(tmp_path / "whole", *settings, terrain=terrain)
    start_levels = whole.env.curriculum.levels.clone()
    run(whole, 8)
    run(make_trainer(tmp_path / "parts", *settings, terrain=terrain), split)
    again = make_trainer(tmp_path / "parts", *settings, terrain=terrain)
    again.load()
    assert run(again, 8) == list(range(split + 1, 9))
    assert differing(saved_state(tmp_path / "whole"), saved_state(tmp_path / "parts")) == []
    assert not torch.equal(whole.env.curriculum.levels, start_levels), "no level moved: the test shows too little"


def test_a_continued_run_does_not_repeat_its_beginning(tmp_path):
    """The exact continuation depends on the random state: without it the two halves would differ from the whole."""
    whole = make_trainer(tmp_path / "whole")
    run(whole, 4)
    run(make_trainer(tmp_path / "parts"), 2)
    again = make_trainer(tmp_path / "parts")
    again.load()
    torch.manual_seed(99)
    run(again, 4)
    assert differing(saved_state(tmp_path / "whole"), saved_state(tmp_path / "parts")) != []


def test_ctrl_c_saves_and_ends_cleanly(tmp_path):
    folder = tmp_path / "run"
    process = start(folder, ["-m", "arrive.cli"])
    try:
        wait_for_rows(process, folder, 2)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=240)
    finally:
        process.kill()
    assert process.returncode == INTERRUPTED, output
    assert "Traceback" not in output
    assert f"run: {folder}" in output
    assert f"arrive train flat,pit --resume {folder} --iterations 100000" in output
    saved = saved_state(folder)["iteration"]
    assert saved == int(log_rows(folder)[-1]["iteration"]) >= 2
    assert sorted(path.name for path in folder.glob("*.p*")) == ["checkpoint.pt", "curves.png", "policy.pt"]
    cli.main(arguments("flat,pit", "--resume", folder, "--iterations", saved + 1))
    assert saved_state(folder)["iteration"] == saved + 1


def test_a_budget_of_minutes_ends_the_run(tmp_path):
    trainer = make_trainer(tmp_path / "run")
    trainer.train(Budget(minutes=0.005), lambda report: None)  # 0.3 s
    assert 0.3 <= trainer.state.elapsed_s < 10.0
    assert saved_state(tmp_path / "run")["iteration"] == trainer.state.iteration >= 1


# NaN and infinity.


def test_a_diverged_robot_is_reset_without_effect_on_others(tmp_path):
    spoilt, twin = (make_trainer(tmp_path / name, "randomisation.push_speed=0").env for name in ("a", "b"))
    actions = torch.zeros(NUM_ENVS, spoilt.num_actions)
    for _ in range(3):
        spoilt.step(actions)
        twin.step(actions)
    spoilt.physics._state["qvel"][5, 2] = math.nan
    observations, rewards, dones, _ = spoilt.step(actions)
    _, twin_rewards, twin_dones, _ = twin.step(actions)
    assert observations[POLICY].isfinite().all()
    others = torch.arange(NUM_ENVS) != 5
    assert spoilt.log.diverged == 1
    assert twin.log.diverged == 0
    assert dones[5] == 1
    assert twin_dones[5] == 0
    assert torch.equal(dones[others], twin_dones[others])
    assert torch.equal(rewards[others], twin_rewards[others])
    assert rewards.isfinite().all()
    assert spoilt.episode_length_buf[5] == 0
    row = spoilt.log.finished.env_ids.tolist().index(5)
    assert not spoilt.log.finished.counted[row], "a diverged simulation says nothing about the policy"
    running = others & (dones == 0)
    after, twin_after = spoilt.physics.state_dict(), twin.physics.state_dict()
    for name in ("qpos", "qvel"):
        assert torch.equal(after[name][running], twin_after[name][running])
        assert after[name].isfinite().all()
    for _ in range(5):
        spoilt.step(actions)
        assert spoilt.log.diverged == 0


def test_training_goes_on_through_a_diverged_robot(tmp_path):
    trainer = make_trainer(tmp_path / "run")

    def report(result):
        diverged.append(result.learning["diverged"])
        if result.iteration == 2:
            trainer.env.physics._state["qpos"][7, 10] = math.inf

    diverged: list[float] = []
    trainer.train(Budget(iterations=4), report)
    assert diverged == [0, 0, 1, 1]
    assert list((tmp_path / "run").glob("dump_*")) == []


# What can be switched on.


def failures(finished: Finished | None) -> Tensor:
    """(NUM_ENVS,) bool: crashed or fell in this step."""
    failed = torch.zeros(NUM_ENVS, dtype=torch.bool)
    if finished is not None:
        failed[finished.env_ids] = finished.failures["crash"] | finished.failures["fell"]
    return failed


def collected(folder, *settings: str) -> tuple[Trainer, Tensor, Tensor, Tensor]:
    """A trainer after one rollout of 32 steps, with the rewards, ends and failures that the environment gave."""
    trainer = make_trainer(folder, "ppo.num_steps=32", *settings)
    rewards, dones, failed = [], [], []
    step = trainer.env.step

    def recording(actions):
        answer = step(actions)
        rewards.append(answer[1].clone())
        dones.append(answer[2].clone())
        failed.append(failures(trainer.env.log.finished))
        return answer

    trainer.env.step = recording
    trainer.collect()
    return trainer, torch.stack(rewards), torch.stack(dones).bool(), torch.stack(failed)


def test_without_bootstrapping_rewards_at_time_outs_are_as_given(tmp_path):
    """The paper: the end of the episode is the end of the task, and its value is that of nothing."""
    trainer, rewards, dones, failed = collected(tmp_path / "run")
    assert (dones & ~failed).any()
    assert torch.equal(trainer.algorithm.storage.rewards.squeeze(-1), rewards)


def test_bootstrapping_adds_the_discounted_value_at_time_outs_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(FinalPositionTask, "bootstraps", True)
    trainer, rewards, dones, failed = collected(tmp_path / "run", "ppo.gamma=0.9")
    storage = trainer.algorithm.storage
    time_out = dones & ~failed
    assert time_out.any()
    assert not time_out.all()
    expected = rewards + 0.9 * storage.values.squeeze(-1) * time_out
    torch.testing.assert_close(storage.rewards.squeeze(-1), expected)
    assert (storage.rewards.squeeze(-1) != rewards)[time_out].all()


def test_all_options_together_train(tmp_path):
    train("flat,gap", tmp_path / "run", 3, "ppo.symmetry=true", "schedule.enabled=true")
    rows = log_rows(tmp_path / "run")
    assert [row["iteration"] for row in rows] == ["1", "2", "3"]
    assert all(-math.inf < float(row["learning/explained_variance"]) <= 1.0 for row in rows)


def test_the_logarithm_of_the_action_noise_is_learnt(tmp_path):
    trainer = make_trainer(tmp_path / "run", "ppo.init_std=0.5")
    parameter = trainer.algorithm.actor.distribution.log_std_param
    assert torch.allclose(parameter, torch.tensor(0.5).log().expand(12))
    assert any(parameter is entry for group in trainer.algorithm.optimizer.param_groups for entry in group["params"])
    run(trainer, 2)
    policy = torch.load(tmp_path / "run" / "policy.pt", weights_only=True)
    assert torch.equal(policy["actor"]["distribution.log_std_param"], parameter.detach())
    assert (parameter.detach().exp() - 0.5).abs().min() > 1e-6


def actor_weights(trainer: Trainer) -> dict[str, Tensor]:
    return {name: value.clone() for name, value in trainer.algorithm.actor.state_dict().items()}


def saved_actor(trainer: Trainer) -> dict[str, Tensor]:
    trainer.save()
    return torch.load(trainer.folder / "policy.pt", weights_only=True)["actor"]


def test_the_saved_policy_is_the_last_network(tmp_path):
    trainer = make_trainer(tmp_path / "run")
    run(trainer, 3)
    assert differing(saved_actor(trainer), actor_weights(trainer)) == []


def test_a_run_can_start_from_the_networks_of_another(tmp_path):
    train("flat", tmp_path / "first", 2)
    first = saved_state(tmp_path / "first")["algorithm"]
    trainer = make_trainer(tmp_path / "second", terrain='["gap"]')
    trainer.warm_start(tmp_path / "first" / "checkpoint.pt")
    assert differing(trainer.algorithm.save(), first) == []
    assert (trainer.state.iteration, trainer.state.samples) == (0, 0)


def test_a_warm_start_from_a_policy_takes_its_actor_and_from_an_export_all_but_the_noise(tmp_path):
    train("flat", tmp_path / "first", 1)
    export_policy(load_policy(tmp_path / "first"), tmp_path / "first.onnx")
    first = load_policy(tmp_path / "first").actor.state_dict()
    for path, lost in ((tmp_path / "first" / "policy.pt", []), (tmp_path / "first.onnx", [f"/{LOG_STD}"])):
        trainer = make_trainer(tmp_path / "second", terrain='["gap"]')
        critic = trainer.algorithm.critic.state_dict
        fresh = {name: value.clone() for name, value in critic().items()}
        policy = read_policy(path)
        assert trainer.warm_start(policy) == policy.samples > 0
        assert differing(actor_weights(trainer), first) == lost
        assert differing(critic(), fresh) == []


def test_a_warm_start_goes_on_at_the_levels_that_were_reached(tmp_path):
    first = make_trainer(tmp_path / "first", terrain='["flat", "gap", "pit"]')
    pits = first.env.family_of_env == 2
    first.env.curriculum.levels[pits] = int(first.env.pool.num_levels[2]) - 1
    first.save()
    second = make_trainer(tmp_path / "second", "terrain.levels=7", terrain='["pit", "stairs"]')
    second.warm_start(tmp_path / "first" / "checkpoint.pt")
    levels = second.env.curriculum.levels
    assert levels[second.env.family_of_env == 0].unique().tolist() == [6]
    assert levels[second.env.family_of_env == 1].unique().tolist() == [0]
    run(second, 1)


# Every terrain.


@pytest.mark.parametrize("family", FAMILIES)
def test_every_terrain_trains(tmp_path, family):
    state = train(family, tmp_path / "run", FAMILY_ITERATIONS)
    assert state["iteration"] == FAMILY_ITERATIONS
    assert state["samples"] == FAMILY_ITERATIONS * NUM_ENVS * STEPS
    check_levels(state, [family] * NUM_ENVS)


def test_all_terrains_train_together(tmp_path):
    state = train("all", tmp_path / "run", ALL_ITERATIONS, num_envs=2 * len(FAMILIES))
    rows = log_rows(tmp_path / "run")
    assert len(rows) == ALL_ITERATIONS
    for family in FAMILIES:
        assert 0.0 <= float(rows[-1][f"arrival/{family}"]) <= 1.0  # NaN if no episode ended there
    check_levels(state, [*FAMILIES, *FAMILIES])
    for row in rows:
        assert all(math.isfinite(float(value)) for name, value in row.items() if name.startswith(("rewards", "learn")))


def check_levels(state: dict, families: list[str]) -> None:
    """Levels stay within those their family has."""
    for name, level in zip(families, state["env"]["levels"].tolist(), strict=True):
        family = FAMILIES[name]
        assert 0 <= level < (1 if family.lowest == family.highest else 3), name


def test_more_terrains_than_robots_is_an_error(tmp_path):
    with pytest.raises(ArriveError, match="num_envs must be at least the number of terrain families, 2, not 1"):
        build_env(override(get_preset("paper"), (*SMALL, "num_envs=1", 'terrain.families=["flat", "pit"]')))
