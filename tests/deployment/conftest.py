"""A policy that was never trained, as a run and as an exported file."""

import pytest
import torch

from arrive.build import build_env
from arrive.cli import main
from arrive.deployment import Controller
from arrive.learning.rundir import write_config
from arrive.learning.trainer import Trainer
from controllers import CONFIG


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """The folder of a run whose untrained networks are made to act as strongly as trained ones."""
    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("run")
    write_config(folder, CONFIG)
    trainer = Trainer(CONFIG, build_env(CONFIG, threads=1), folder)
    with torch.no_grad():
        trainer.algorithm.get_policy().mlp[-1].weight.mul_(3.0)
    trainer.save()
    return folder


@pytest.fixture(scope="session")
def exported(run):
    """The file that the command line makes of it."""
    main(["export", str(run), "-o", str(run / "robot.onnx")])
    return run / "robot.onnx"


@pytest.fixture
def controller(exported):
    return Controller.load(exported)
