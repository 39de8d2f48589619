"""Two processes train one policy: averaged gradients, separate states, and logs of rank 0 alone."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import nn

import distributed_worker
from arrive.errors import ArriveError
from arrive.learning.checkpoint import CHECKPOINT_NAME
from arrive.learning.ranks import join_ranks
from distributed_worker import CONFIG, make_trainer

WORKER = Path(distributed_worker.__file__)


def torchrun(*arguments: str, processes: int = 2) -> subprocess.CompletedProcess:
    """Start processes by torch's launcher on a free port of this machine."""
    launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.run([*launcher, *arguments], capture_output=True, text=True, timeout=300, env=environment)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where the worker has left what it did, a folder for each of its parts."""
    path = tmp_path_factory.mktemp("distributed")
    answer = torchrun(str(WORKER), str(path))
    assert answer.returncode == 0, answer.stderr
    return path


def left_by(folder: Path, part: str) -> list[dict]:
    """What each process wrote."""
    return [torch.load(folder / part / f"{rank}.pt") for rank in range(2)]


def stepped(before: dict, gradients: dict) -> dict[str, torch.Tensor]:
    """Parameters after a step of Adam with gradients clipped per network, by torch alone."""
    values = {name: nn.Parameter(value.clone()) for name, value in before.items()}
    for name, value in values.items():
        value.grad = gradients[name].clone()
    for network in ("actor", "critic"):
        nn.utils.clip_grad_norm_([v for n, v in values.items() if n.startswith(network)], CONFIG.ppo.max_grad_norm)
    torch.optim.Adam(values.values(), lr=CONFIG.ppo.learning_rate).step()
    return {name: value.detach() for name, value in values.items()}


def test_an_update_is_a_step_along_the_averaged_gradient(folder):
    first, second = left_by(folder, "one_update")
    for name, value in first["before"].items():
        assert torch.equal(value, second["before"][name]), name
        assert torch.equal(first["after"][name], second["after"][name]), name
    mean = {name: (value + second["gradients"][name]) / 2 for name, value in first["gradients"].items()}
    expected = stepped(first["before"], mean)
    alone = stepped(first["before"], first["gradients"])
    for name, value in first["after"].items():
        torch.testing.assert_close(value, expected[name], atol=1e-7, rtol=1e-5, msg=name)
    # The processes saw different robots, so that neither's own gradient leads there.
    assert any(not torch.allclose(first["after"][name], alone[name], atol=1e-5) for name in alone)


def test_a_resumed_run_of_two_processes_goes_on_bit_for_bit(folder):
    results = left_by(folder, "resume")
    for result in results:
        whole, resumed = result["parameters"]
        for name, value in whole.items():
            assert torch.equal(value, resumed[name]), name
        assert torch.equal(*result["observations"])
        assert result["samples"] == 2 * 2 * CONFIG.num_envs * CONFIG.ppo.num_steps
    assert not torch.equal(results[0]["observations"][0], results[1]["observations"][0])
    with pytest.raises(ArriveError, match="made by 2 processes: resume with the same number"):
        make_trainer(join_ranks(torch.device("cpu")), folder / "resume" / "parts").load()


def test_both_go_back_when_one_meets_a_nan(folder):
    first, second = left_by(folder, "spoil")
    assert first["iteration"] == second["iteration"] == 2
    for name, value in first["after"].items():
        assert value.isfinite().all()
        assert torch.equal(value, second["after"][name]), name
    assert (folder / "spoil" / "dump_0.pt").is_file()
    assert (folder / "spoil" / "rank1" / "dump_0.pt").is_file()


def test_a_single_process_does_not_communicate():
    ranks = join_ranks(torch.device("cpu"))
    assert (ranks.rank, ranks.count, ranks.leads, ranks.seed_offset, ranks.settings()) == (0, 1, True, 0, None)
    assert ranks.gather("a") == ["a"]
    assert ranks.share("b") == "b"
    assert ranks.any(True)
    assert not ranks.any(False)


def test_the_command_line_under_torchrun_logs_once(tmp_path):
    run = tmp_path / "run"
    options = ["--iterations", "2", "--num-envs", "8", "--threads", "1", "--device", "cpu", "--out", str(run)]
    sizes = ["terrain.levels=1", "terrain.variants=1", "ppo.num_steps=4", "ppo.hidden=[16]"]
    answer = torchrun("-m", "arrive.cli", "train", "flat", *options, "--set", *sizes)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.count("device: CPU") == 1
    assert "2 processes" in answer.stdout
    assert len((run / "log.csv").read_text().splitlines()) == 3
    assert json.loads((run / "config.json").read_text())["config"]["num_envs"] == 8
    content = torch.load(run / CHECKPOINT_NAME)
    assert content["samples"] == 2 * 2 * 8 * 4
    assert len(content["state"]["others"]) == 1
