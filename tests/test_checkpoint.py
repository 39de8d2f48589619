"""Checkpoints: written whole or not at all, read without executing anything, refused with a reason."""

import errno
import os
import pickle
import shutil
import subprocess
import sys

import pytest
import torch

from arrive.build import build_env
from arrive.config import override
from arrive.errors import ArriveError
from arrive.evaluation.policy import load_policy
from arrive.learning import checkpoint
from arrive.learning.checkpoint import (
    CHECKPOINT_NAME,
    FORMAT,
    POLICY_NAME,
    check_schema,
    load_checked,
    save_atomically,
)
from arrive.learning.rundir import new_run_folder, write_config
from arrive.learning.trainer import Trainer
from arrive.presets import get_preset

CONTENT = {
    "format": FORMAT,
    "schema": [{"name": "base_lin_vel", "start": 0, "stop": 3}],
    "weights": torch.arange(999.0),
}
CONFIG = override(
    get_preset("paper"),
    ("num_envs=4", "ppo.hidden=[8]", "ppo.num_steps=2", "terrain.levels=1", "terrain.variants=1"),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of an untrained run, with checkpoint and policy."""
    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("run")
    write_config(folder, CONFIG)
    Trainer(CONFIG, build_env(CONFIG, threads=1), folder).save()
    return folder


def changed_copy(path, folder, **changes):
    """A copy of a saved file in another folder, with entries replaced."""
    content = torch.load(path, weights_only=True) | changes
    torch.save(content, folder / path.name)
    return folder / path.name


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_is_saved_is_read_back(tmp_path):
    path = tmp_path / "new" / "folder" / "checkpoint.pt"
    save_atomically(CONTENT, path)
    content = load_checked(path)
    assert content["schema"] == CONTENT["schema"]
    assert torch.equal(content["weights"], CONTENT["weights"])
    assert names(path.parent) == ["checkpoint.pt"]


class Stop(BaseException):
    """Not an Exception, as a keyboard interrupt."""


@pytest.mark.parametrize(
    ("failure", "raised"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), ArriveError),
        (RuntimeError("PytorchStreamWriter failed writing file"), ArriveError),
        (KeyboardInterrupt(), KeyboardInterrupt),
        (Stop(), Stop),
    ],
    ids=["disk full", "torch's own error", "interrupt", "exit"],
)
def test_a_failure_while_writing_leaves_the_old_file_whole(tmp_path, monkeypatch, failure, raised):
    path = tmp_path / "checkpoint.pt"
    save_atomically(CONTENT, path)
    before = path.read_bytes()
    saved = []

    def write_half(content, file):
        file.write(before[: len(before) // 2])
        file.flush()
        saved.extend(names(tmp_path))
        raise failure

    monkeypatch.setattr(checkpoint.torch, "save", write_half)
    with pytest.raises(raised):
        save_atomically({"format": FORMAT}, path)
    assert len(saved) == 2, "the half file was meant to exist beside the old one"
    assert names(tmp_path) == ["checkpoint.pt"]
    assert path.read_bytes() == before


@pytest.mark.parametrize("function", ["replace", "fsync", "fdopen"])
def test_a_full_disk_at_any_moment_is_an_error_that_says_so(tmp_path, monkeypatch, function):
    path = tmp_path / "checkpoint.pt"
    save_atomically(CONTENT, path)
    before = path.read_bytes()

    def full(*args, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint.os, function, full)
        with pytest.raises(ArriveError, match=r"checkpoint\.pt.*No space left.*space"):
            save_atomically({"format": FORMAT}, path)
    assert path.read_bytes() == before
    assert names(tmp_path) == ["checkpoint.pt"]


def test_a_folder_that_cannot_be_written_is_an_error_that_names_the_file(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(ArriveError, match=r"file/run/checkpoint\.pt"):
        save_atomically(CONTENT, tmp_path / "file" / "run" / "checkpoint.pt")


@pytest.mark.parametrize("name", [CHECKPOINT_NAME, POLICY_NAME])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99, 0.9999])
def test_a_truncated_file_is_refused(run, tmp_path, name, share):
    data = (run / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(ArriveError, match=rf"{name}.*truncated"):
        load_checked(tmp_path / name)


@pytest.mark.parametrize("content", [b"hello, world\n" * 50, b"\x89PNG\r\n\x1a\n" + bytes(100), bytes(5000)])
def test_a_file_of_another_kind_is_refused(tmp_path, content):
    (tmp_path / "policy.pt").write_bytes(content)
    with pytest.raises(ArriveError, match="not a checkpoint of arrive"):
        load_checked(tmp_path / "policy.pt")


@pytest.mark.parametrize("content", [{"model_state_dict": {}, "iter": 3}, [1, 2], torch.ones(3), {"format": FORMAT}])
def test_a_file_that_torch_can_read_but_is_not_ours_is_refused(tmp_path, content):
    torch.save(content, tmp_path / "policy.pt")
    with pytest.raises(ArriveError, match="not a checkpoint of arrive"):
        load_checked(tmp_path / "policy.pt")


class Malicious:
    """Runs a command on the machine that unpickles it."""

    def __init__(self, target):
        self.target = target

    def __reduce__(self):
        return os.system, (f"touch '{self.target}'",)


@pytest.mark.parametrize("legacy", [False, True], ids=["zip", "pickle"])
def test_code_in_a_file_is_not_executed(tmp_path, legacy):
    target, path = tmp_path / "executed", tmp_path / "policy.pt"
    content = CONTENT | {"extra": Malicious(target)}
    if legacy:
        path.write_bytes(pickle.dumps(content, protocol=2))
    else:
        torch.save(content, path)
    with pytest.raises(ArriveError, match=r"cannot read .*policy\.pt"):
        load_policy(path)
    assert not target.exists()
    torch.load(path, weights_only=False) if not legacy else pickle.loads(path.read_bytes())
    assert target.exists(), "the file would have done nothing anyway"


@pytest.mark.parametrize("missing", ["nowhere/policy.pt", "."])
def test_a_missing_file_is_named(tmp_path, missing):
    with pytest.raises(ArriveError, match=r"no file .*policy\.pt"):
        load_policy(tmp_path / missing)


def test_a_newer_format_is_refused_with_both_numbers(run, tmp_path):
    for name in (CHECKPOINT_NAME, POLICY_NAME):
        path = changed_copy(run / name, tmp_path, format=FORMAT + 1)
        with pytest.raises(ArriveError, match=rf"format {FORMAT + 1}, this version reads {FORMAT}"):
            load_checked(path)


def trainer_in(folder, *changes):
    config = override(CONFIG, changes)
    return Trainer(config, build_env(config, threads=1), folder)


def test_a_checkpoint_of_another_robot_is_refused(run, tmp_path):
    changed_copy(run / CHECKPOINT_NAME, tmp_path, robot="spot")
    with pytest.raises(ArriveError, match=r"robot 'spot', not 'anymal_c'"):
        trainer_in(tmp_path).load()


def test_a_checkpoint_of_another_observation_is_refused(run, tmp_path):
    """A coarser height grid gives fewer entries; the networks must not be fed by position."""
    coarse = trainer_in(tmp_path, "observation.grid_step=0.2")
    with pytest.raises(ArriveError, match=r"another observation.*'height"):
        coarse.warm_start(run / CHECKPOINT_NAME)


def test_a_checkpoint_of_another_configuration_is_not_resumed(run, tmp_path):
    changed_copy(run / CHECKPOINT_NAME, tmp_path)
    with pytest.raises(ArriveError, match="another configuration"):
        trainer_in(tmp_path, "ppo.gamma=0.9").load()


def test_a_policy_of_another_observation_is_not_evaluated(run):
    policy = load_policy(run)
    env = build_env(override(CONFIG, ("observation.grid_length=1.2",)), threads=1)
    with pytest.raises(ArriveError, match="another observation"):
        policy.check(env)
    policy.check(build_env(CONFIG, threads=1))


def test_a_training_checkpoint_is_not_taken_for_a_policy(run):
    with pytest.raises(ArriveError, match=r"policy\.pt"):
        load_policy(run / CHECKPOINT_NAME)


def test_networks_that_do_not_fit_the_configuration_are_refused(run, tmp_path):
    path = changed_copy(run / POLICY_NAME, tmp_path)
    content = torch.load(path, weights_only=True)
    content["config"]["ppo"]["hidden"] = [9]
    torch.save(content, path)
    with pytest.raises(ArriveError, match="do not fit"):
        load_policy(path)


ROW = {"name": "height", "start": 0, "stop": 2, "unit": "m", "frame": "base", "scale": 5.0, "labels": ["a", "b"]}


@pytest.mark.parametrize(
    ("change", "word"), [({"scale": 1.0}, "scale"), ({"labels": ["b", "a"]}, "labels"), ({"unit": "cm"}, "unit")]
)
def test_a_schema_that_differs_in_meaning_alone_is_refused(tmp_path, change, word):
    """The sizes fit, so that nothing but the schema could tell."""
    with pytest.raises(ArriveError, match=f"'height'.*differs in {word}"):
        check_schema([ROW | change], [ROW], tmp_path)
    with pytest.raises(ArriveError, match="1 observation terms, this configuration has 2"):
        check_schema([ROW], [ROW, ROW], tmp_path)
    check_schema([ROW], [ROW], tmp_path)


def test_a_policy_file_acts_as_the_network_that_was_saved(run):
    trainer = trainer_in(run)
    trainer.load()
    observations = trainer.env.get_observations()
    with torch.inference_mode():
        expected = trainer.algorithm.actor(observations)
    assert torch.equal(load_policy(run).act(observations["policy"]), expected)


def test_a_checkpoint_of_another_version_is_not_resumed(run, tmp_path):
    folder = tmp_path / "older"
    shutil.copytree(run, folder)
    content = torch.load(folder / CHECKPOINT_NAME, weights_only=True)
    del content["state"]["env"]["exploration"]["sums"]
    torch.save(content, folder / CHECKPOINT_NAME)
    with pytest.raises(ArriveError, match=r"another version of arrive.*--start-from"):
        trainer_in(folder).load()


def test_a_folder_that_holds_a_run_is_not_overwritten(run):
    with pytest.raises(ArriveError, match="already holds a run"):
        new_run_folder(CONFIG, run)


def test_a_real_full_disk_keeps_the_old_checkpoint(tmp_path):
    """A limit on the size of files, which binds the administrator too, stops the write in the middle."""
    path = tmp_path / "checkpoint.pt"
    save_atomically(CONTENT, path)
    before = path.read_bytes()
    code = f"""
import pathlib, resource, signal, torch
from arrive.errors import ArriveError
from arrive.learning.checkpoint import save_atomically
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
try:
    save_atomically({{"format": 1, "weights": torch.zeros(100000)}}, pathlib.Path({str(path)!r}))
except ArriveError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "cannot write" in done.stdout, done.stderr
    assert path.read_bytes() == before
    assert names(tmp_path) == ["checkpoint.pt"]
