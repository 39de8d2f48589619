"""Reads an exported policy's network, for evaluation and training."""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from arrive.config import saved_config
from arrive.deployment.onnx_file import read_onnx_file
from arrive.deployment.policy_file import read_policy_file
from arrive.learning.checkpoint import Origin
from arrive.learning.policy import LOG_STD, Policy, build_policy


def load_exported(path: Path, device: torch.device | str = "cpu") -> Policy:
    """Read an exported policy as `load_policy` reads a policy.pt.

    The file does not contain the action noise, so the actor gets the initial noise of its training.

    Raises:
        ArriveError: the file cannot be read or fails its checks, see `read_policy_file`.
    """
    file = read_policy_file(path)
    training = file.meta["training"]
    config = saved_config(training["config"], path)
    origin = Origin(config.robot, config, file.meta["observation"], training["commit"], 0, training["samples"])
    joints = len(file.robot.joint_names)
    noise = torch.full((joints,), math.log(config.ppo.init_std))
    constants = read_onnx_file(path).weights
    weights = _layers(constants) | _facing(constants)
    return build_policy(origin, weights | {LOG_STD: noise}, path, device)


def _layers(constants: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """The linear layers. The activations between them have no weights."""
    numbers = sorted(int(name[1:]) for name in constants if name[0] == "w")
    names = {"w": "weight", "b": "bias"}
    return {
        f"mlp.{number}.{names[kind]}": torch.tensor(constants[f"{kind}{number}"])
        for number in numbers
        for kind in names
    }


def _facing(constants: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """The maps of the reflections, one row each; empty for a network without symmetry."""
    names = {
        "observation_index": "o{}_index",
        "observation_sign": "o{}_sign",
        "action_index": "a{}_index",
        "action_sign": "a{}_sign",
        "side": "side{}",
    }
    count = sum(name.startswith("side") for name in constants)
    if not count:
        return {}
    rows = {own: np.stack([constants[name.format(row)] for row in range(count)]) for own, name in names.items()}
    rows["side"] = rows["side"][:, 0]
    return {f"facing.{own}": torch.tensor(values) for own, values in rows.items()}
