"""Checkpoint and policy files: a digest, no executed code, and reasons for refused files."""

import math
import os
import pickle
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
import torch

from arrive.build import build_env
from arrive.config import override
from arrive.errors import ArriveError
from arrive.learning import checkpoint
from arrive.learning.checkpoint import (
    CHECKPOINT_NAME,
    FORMAT,
    POLICY_NAME,
    check_schema,
    is_sealed,
    load_checkpoint,
    load_policy_file,
    save_sealed,
)
from arrive.learning.policy import load_policy
from arrive.learning.rundir import write_config
from arrive.learning.trainer import Trainer
from arrive.presets import get_preset

ROOT = Path(__file__).parents[2]

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
    """A sealed copy of a saved file in another folder, with entries replaced."""
    content = torch.load(path, weights_only=True) | changes
    save_sealed(content, folder / path.name)
    return folder / path.name


def load(path):
    """Read a file as what its name says that it is."""
    return (load_policy_file if path.name == POLICY_NAME else load_checkpoint)(path)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_is_saved_is_read_back(run):
    trainer = trainer_in(run)
    origin, weights = load_policy_file(run / POLICY_NAME)
    assert (origin.robot, origin.config, origin.samples) == ("anymal_c", CONFIG, 0)
    assert origin.schema == trainer.env.observer.schema()
    _, state = load_checkpoint(run / CHECKPOINT_NAME)
    for name, value in state["algorithm"]["actor_state_dict"].items():
        assert torch.equal(weights[name], value)


def test_torch_can_read_a_file_with_a_digest(tmp_path):
    save_sealed(CONTENT, tmp_path / "policy.pt")
    assert torch.equal(torch.load(tmp_path / "policy.pt", weights_only=True)["weights"], CONTENT["weights"])
    assert is_sealed((tmp_path / "policy.pt").read_bytes())


def test_a_failure_of_torch_while_saving_leaves_the_old_file(tmp_path, monkeypatch):
    save_sealed(CONTENT, tmp_path / "policy.pt")
    before = (tmp_path / "policy.pt").read_bytes()

    def interrupted(content, file):
        raise KeyboardInterrupt

    monkeypatch.setattr(checkpoint.torch, "save", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_sealed({}, tmp_path / "policy.pt")
    assert (tmp_path / "policy.pt").read_bytes() == before
    assert names(tmp_path) == ["policy.pt"]


def test_a_thousand_flipped_bits_are_all_noticed(run, tmp_path):
    """Half of them anywhere, half of them in the last kilobyte, where the zip's directory and the digest are."""
    data, random = (run / POLICY_NAME).read_bytes(), Random(1)
    path = tmp_path / POLICY_NAME
    bits = [random.randrange(8 * len(data)) for _ in range(500)]
    bits += [8 * len(data) - 1 - random.randrange(8 * 1024) for _ in range(500)]
    assert is_sealed(data)
    assert not any(is_sealed(flipped(data, bit)) for bit in bits)
    for bit in bits[::20]:
        path.write_bytes(flipped(data, bit))
        with pytest.raises(ArriveError, match=r"cannot read .*policy\.pt.* corrupt"):
            load_policy(path)


def flipped(data: bytes, bit: int) -> bytes:
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def damaged(weights: dict, change) -> dict:
    """The weights with one of them changed."""
    name = next(iter(weights))
    return weights | {name: change(weights[name].clone())}


def with_value(value: float):
    return lambda tensor: tensor.index_fill_(0, torch.tensor([0]), value)


BAD_WEIGHTS = {
    "NaN": (with_value(math.nan), "not finite"),
    "infinite": (with_value(-math.inf), "not finite"),
    "complex": (lambda tensor: tensor.to(torch.complex64), "complex64, not torch.float32"),
    "float64": (lambda tensor: tensor.double(), "float64, not torch.float32"),
    "integer": (lambda tensor: tensor.long(), "int64, not torch.float32"),
}


@pytest.mark.parametrize("kind", BAD_WEIGHTS)
def test_a_sealed_file_with_bad_weights_is_refused(run, tmp_path, kind):
    change, word = BAD_WEIGHTS[kind]
    actor = torch.load(run / POLICY_NAME, weights_only=True)["actor"]
    path = changed_copy(run / POLICY_NAME, tmp_path, actor=damaged(actor, change))
    with pytest.raises(ArriveError, match=rf"policy\.pt is damaged: .*{word}"):
        load_policy(path)
    state = torch.load(run / CHECKPOINT_NAME, weights_only=True)["state"]
    algorithm = state["algorithm"]
    algorithm["critic_state_dict"] = damaged(algorithm["critic_state_dict"], change)
    path = changed_copy(run / CHECKPOINT_NAME, tmp_path, state=state)
    with pytest.raises(ArriveError, match=rf"checkpoint\.pt is damaged: critic_state_dict.*{word}"):
        load_checkpoint(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"robot": None},
        {"robot": ["anymal_c"]},
        {"config": "paper"},
        {"config": {"ppo": 3}},
        {"config": {"nonsense": 3}},
        {"schema": []},
        {"schema": [1, 2]},
        {"schema": [{"name": "height"}]},
        {"schema": None},
        {"samples": "many"},
        {"commit": 3},
        {"iteration": None},
        {"actor": None},
        {"actor": {}},
        {"actor": [1.0]},
        {"actor": {"mlp.0.weight": torch.ones(8, 3)}},
        {"actor": {"distribution.log_std_param": torch.ones(12)}},
        {"actor": {"distribution.log_std_param": torch.tensor(1.0)}},
        {"actor": {"distribution.log_std_param": 3}},
    ],
    ids=str,
)
def test_a_valid_digest_with_wrong_entries_is_refused(run, tmp_path, changes):
    path = changed_copy(run / POLICY_NAME, tmp_path, **changes)
    with pytest.raises(ArriveError) as refused:
        load_policy(path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "state", [None, {}, [], {"algorithm": None}, {"algorithm": {}}, {"algorithm": {"a": torch.ones(2)}}], ids=str
)
def test_a_checkpoint_with_a_wrong_state_is_neither_resumed_nor_started_from(run, tmp_path, state):
    changed_copy(run / CHECKPOINT_NAME, tmp_path, state=state)
    trainer = trainer_in(tmp_path)
    for way in (trainer.load, lambda: trainer.warm_start(tmp_path / CHECKPOINT_NAME)):
        with pytest.raises(ArriveError, match=r"checkpoint\.pt"):
            way()


@pytest.mark.parametrize("name", [CHECKPOINT_NAME, POLICY_NAME])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99, 0.9999])
def test_a_truncated_file_is_refused(run, tmp_path, name, share):
    data = (run / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(ArriveError, match=rf"{name}.*truncated"):
        load(tmp_path / name)


@pytest.mark.parametrize("content", [b"hello, world\n" * 50, b"\x89PNG\r\n\x1a\n" + bytes(100), bytes(5000)])
def test_a_file_of_another_kind_is_refused(tmp_path, content):
    (tmp_path / "policy.pt").write_bytes(content)
    with pytest.raises(ArriveError, match="not a checkpoint of arrive"):
        load_policy_file(tmp_path / "policy.pt")


@pytest.mark.parametrize("content", [{"model_state_dict": {}, "iter": 3}, [1, 2], torch.ones(3), {"format": FORMAT}])
@pytest.mark.parametrize("sealed", [False, True])
def test_a_file_that_torch_can_read_but_is_not_ours_is_refused(tmp_path, content, sealed):
    (save_sealed if sealed else torch.save)(content, tmp_path / "policy.pt")
    with pytest.raises(ArriveError, match="not a checkpoint of arrive"):
        load_policy_file(tmp_path / "policy.pt")


class Malicious:
    """Runs a command on the machine that unpickles it."""

    def __init__(self, target):
        self.target = target

    def __reduce__(self):
        return os.system, (f"touch '{self.target}'",)


@pytest.mark.parametrize("kind", ["zip", "sealed", "pickle"])
def test_code_in_a_file_is_not_executed(tmp_path, kind):
    target, path = tmp_path / "executed", tmp_path / "policy.pt"
    content = CONTENT | {"extra": Malicious(target)}
    if kind == "pickle":
        path.write_bytes(pickle.dumps(content, protocol=2))
    else:
        (save_sealed if kind == "sealed" else torch.save)(content, path)
    with pytest.raises(ArriveError, match=r"policy\.pt.* not a checkpoint of arrive"):
        load_policy(path)
    assert not target.exists()
    pickle.loads(path.read_bytes()) if kind == "pickle" else torch.load(path, weights_only=False)
    assert target.exists(), "the file would have done nothing anyway"


@pytest.mark.parametrize(("missing", "words"), [("nowhere/policy.pt", "no policy "), (".", "no file ")])
def test_a_missing_file_is_named(tmp_path, missing, words):
    with pytest.raises(ArriveError, match=rf"{words}.*policy\.pt"):
        load_policy(tmp_path / missing)


def test_a_newer_format_is_refused_with_both_numbers(run, tmp_path):
    for name in (CHECKPOINT_NAME, POLICY_NAME):
        path = changed_copy(run / name, tmp_path, format=FORMAT + 1)
        with pytest.raises(ArriveError, match=rf"format {FORMAT + 1}, this version reads {FORMAT}"):
            load(path)


def trainer_in(folder, *changes):
    config = override(CONFIG, changes)
    return Trainer(config, build_env(config, threads=1), folder)


def test_a_checkpoint_of_another_robot_is_refused(run, tmp_path):
    changed_copy(run / CHECKPOINT_NAME, tmp_path, robot="spot")
    with pytest.raises(ArriveError, match=r"robot 'spot', not 'anymal_c'"):
        trainer_in(tmp_path).load()


def test_a_checkpoint_of_another_observation_is_refused(run, tmp_path):
    """A coarser height grid gives fewer entries; the networks must not be fed by position."""
    coarse = trainer_in(tmp_path, "observation.heights.step=0.2")
    with pytest.raises(ArriveError, match=r"another observation.*'height"):
        coarse.warm_start(run / CHECKPOINT_NAME)


def test_a_checkpoint_of_another_configuration_is_not_resumed(run, tmp_path):
    changed_copy(run / CHECKPOINT_NAME, tmp_path)
    with pytest.raises(ArriveError, match="another configuration"):
        trainer_in(tmp_path, "ppo.gamma=0.9").load()


def test_a_policy_of_another_observation_is_not_evaluated(run):
    policy = load_policy(run)
    env = build_env(override(CONFIG, ("observation.heights.length=1.2",)), threads=1)
    with pytest.raises(ArriveError, match="another observation"):
        policy.check(env)
    policy.check(build_env(CONFIG, threads=1))


def test_a_training_checkpoint_is_not_taken_for_a_policy(run):
    with pytest.raises(ArriveError, match=r"policy\.pt"):
        load_policy(run / CHECKPOINT_NAME)


def test_networks_that_do_not_fit_the_configuration_are_refused(run, tmp_path):
    content = torch.load(run / POLICY_NAME, weights_only=True)
    content["config"]["ppo"]["hidden"] = [9]
    save_sealed(content, tmp_path / POLICY_NAME)
    with pytest.raises(ArriveError, match="do not fit") as refused:
        load_policy(tmp_path)
    assert "\n" not in str(refused.value)


ROW = {"name": "height", "start": 0, "stop": 2, "unit": "m", "frame": "base", "scale": 5.0, "labels": ["a", "b"]}


@pytest.mark.parametrize(
    ("change", "word"), [({"scale": 1.0}, "scale"), ({"labels": ["b", "a"]}, "labels"), ({"unit": "cm"}, "unit")]
)
def test_a_schema_that_differs_in_meaning_alone_is_refused(tmp_path, change, word):
    """The sizes fit, so that nothing but the schema could tell."""
    with pytest.raises(ArriveError, match=f"'height'.*differ in {word}"):
        check_schema([ROW | change], [ROW], tmp_path)
    with pytest.raises(ArriveError, match="1 observation terms, this configuration has 2"):
        check_schema([ROW], [ROW, ROW], tmp_path)
    check_schema([ROW], [ROW], tmp_path)


def test_labels_that_older_versions_rounded_mean_the_same_points(tmp_path):
    present = ROW | {"labels": ["(-0.375, 0.5)", "(0, -0.125)"]}
    check_schema([ROW | {"labels": ["(-0.4, 0.5)", "(0.0, -0.1)"]}], [present], tmp_path)
    for labels in (["(-0.5, 0.5)", "(0.0, -0.1)"], ["(-0.38, 0.5)", "(0.0, -0.1)"], ["(-0.4, 0.5)"], ["a", "b"], None):
        with pytest.raises(ArriveError, match="differ in labels"):
            check_schema([ROW | {"labels": labels}], [present], tmp_path)


def test_a_policy_file_acts_as_the_network_that_was_saved(run):
    trainer = trainer_in(run)
    trainer.load()
    observations = trainer.env.get_observations()
    with torch.inference_mode():
        expected = trainer.algorithm.actor(observations)
    assert torch.equal(load_policy(run).act(observations["policy"]), expected)


def test_a_checkpoint_of_another_version_is_not_resumed(run, tmp_path):
    state = torch.load(run / CHECKPOINT_NAME, weights_only=True)["state"]
    del state["env"]["exploration"]["sums"]
    changed_copy(run / CHECKPOINT_NAME, tmp_path, state=state)
    with pytest.raises(ArriveError, match=r"another version of arrive.*--start-from"):
        trainer_in(tmp_path).load()


def test_a_policy_is_read_by_a_program_that_imports_nothing_else():
    """A saved configuration needs its task, which its own module registers."""
    program = "from arrive.learning.policy import load_policy\nprint(load_policy('policies/slope').config.task.name)"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "final\n", done.stderr
