"""The choice of a device. An unusable device is an error that says why and what to do."""

import numpy as np
import pytest
import torch

from arrive.cli import main
from arrive.errors import ArriveError
from arrive.physics import PhysicsConfig, device
from arrive.physics.cpu import CpuPhysics
from arrive.physics.device import choose_device, describe_device, make_physics, why_no_gpu
from arrive.physics.world import compile_world
from arrive.robots import get_robot
from arrive.terrain import build_tile, get_family


@pytest.fixture
def machine(monkeypatch):
    """A function that pretends what this machine has; torch itself is not asked."""

    def pretend(cuda: str | None = "13.0", gpus: int = 1, warp: bool = True, local_rank: int = 0) -> None:
        monkeypatch.setattr(torch.version, "cuda", cuda)
        monkeypatch.setattr(torch.cuda, "is_available", lambda: cuda is not None and gpus > 0)
        monkeypatch.setattr(torch.cuda, "device_count", lambda: gpus)
        monkeypatch.setattr(torch.cuda, "set_device", lambda index: None)
        monkeypatch.setattr(device, "has_warp", lambda: warp)
        monkeypatch.setenv("LOCAL_RANK", str(local_rank))

    return pretend


@pytest.mark.parametrize(
    ("lack", "advice"),
    [
        ({"cuda": None}, "this torch is built without CUDA: install one"),
        ({"gpus": 0}, "torch finds no NVIDIA GPU or driver: check that nvidia-smi"),
        ({"warp": False}, "MuJoCo Warp is not installed: pip install"),
    ],
)
def test_an_unusable_gpu_is_an_error_of_one_sentence(machine, lack, advice):
    machine(**lack)
    with pytest.raises(ArriveError, match=f"--device cuda: {advice}"):
        choose_device("cuda")
    assert choose_device("auto") == torch.device("cpu")
    assert advice in describe_device(torch.device("cpu"), "auto", 2)
    assert "GPU" not in describe_device(torch.device("cpu"), "cpu", 2)


def test_each_process_takes_the_gpu_of_its_local_rank(machine):
    machine(gpus=2, local_rank=1)
    assert why_no_gpu() == ""
    assert choose_device("auto") == choose_device("cuda") == torch.device("cuda", 1)
    assert choose_device("cpu") == torch.device("cpu")
    machine(gpus=1, local_rank=1)
    with pytest.raises(ArriveError, match="process 1 of this machine has no GPU: start 1"):
        choose_device("cuda")


def test_the_engine_belongs_to_the_device():
    robot = get_robot("anymal_c")
    tile = build_tile(get_family("flat"), 0.0, np.random.default_rng(0), "training")
    world = compile_world(robot, tile, PhysicsConfig())
    physics = make_physics(robot, [world], PhysicsConfig(), 1, 1, torch.device("cpu"))
    assert isinstance(physics, CpuPhysics)
    with pytest.raises(ArriveError, match=r"physics\.engine=mujoco runs on the CPU"):
        make_physics(robot, [world], PhysicsConfig(engine="mujoco"), 1, 1, torch.device("cuda"))


def test_an_unusable_device_is_an_error_before_files_are_written(machine, tmp_path, capsys):
    machine(cuda=None)
    with pytest.raises(SystemExit):
        main(["train", "flat", "--iterations", "1", "--device", "cuda", "--out", str(tmp_path / "run")])
    assert capsys.readouterr().err.startswith("arrive: --device cuda: this torch is built without CUDA")
    assert not (tmp_path / "run").exists()
