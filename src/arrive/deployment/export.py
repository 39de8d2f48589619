"""Writes a trained policy as one ONNX file that explains itself, and compares such a file with this version."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from arrive.config import Config, from_dict, to_dict
from arrive.deployment.onnx_file import PREFIX, seal
from arrive.deployment.policy_file import FORMAT, INPUT, OUTPUT, PolicyFile, read_policy_file
from arrive.deployment.writing import write_whole
from arrive.errors import ArriveError
from arrive.evaluation.records import DIFFICULTY_NAME
from arrive.learning.checkpoint import check_schema
from arrive.learning.policy import Policy
from arrive.robots import get_robot
from arrive.robots.robot import Robot
from arrive.task.heights import HeightGrid
from arrive.task.observations import HEIGHT_CLIP, HEIGHT_OFFSET, Observer
from arrive.task.registry import get_task
from arrive.terrain.pool import Rasters

OPSET, IR_VERSION = 17, 8
"""Old enough for every onnxruntime since 1.13."""
GOLDEN_PAIRS, GOLDEN_SEED = 16, 0


def export_policy(policy: Policy, out: Path) -> None:
    """Write a policy with all that running it takes, whole or not at all; it is read back before it takes its place.

    Raises:
        ArriveError: it was trained on another observation than this version's, its networks are of an unknown kind,
            its numbers cannot be right, or the file cannot be written.
    """
    sections = describe(policy.config)
    check_schema(policy.schema, sections["observation"], policy.path)
    sections |= {
        "format": FORMAT,
        "training": {"config": to_dict(policy.config), "commit": policy.commit, "samples": policy.samples},
        "evaluation": _evaluation(policy.path.parent / DIFFICULTY_NAME),
        "golden": _golden(policy),
    }
    model = _graph(policy.actor.mlp)
    helper.set_model_props(model, {PREFIX + name: json.dumps(value) for name, value in sections.items()})
    onnx.checker.check_model(model)
    write_whole(out, seal(model.SerializeToString()), read_policy_file)


def compare_with_this_version(file: PolicyFile) -> None:
    """Make sure that a file's robot, observation, grid, period and task are what this version has under these names.

    Raises:
        ArriveError: they are not; the message names the first place that differs.
    """
    try:
        config = from_dict(Config, file.meta["training"]["config"])
    except (KeyError, TypeError, AttributeError) as error:
        raise ArriveError(f"the metadata of {file.path} is damaged: {error!r}. Export the policy again.") from error
    for section, expected in describe(config).items():
        _compare(file.path, section, file.meta[section], expected)


def _compare(path: Path, where: str, found: Any, expected: Any) -> None:
    """Report the first difference by its place."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for name in expected | found:
            _compare(path, f"{where}.{name}", found.get(name), expected.get(name))
    elif isinstance(expected, list) and isinstance(found, list) and len(found) == len(expected):
        for i, pair in enumerate(zip(found, expected, strict=True)):
            _compare(path, f"{where}[{i}]", *pair)
    elif found != expected:
        raise ArriveError(f"{path} does not fit this version of arrive: {where} is {found!r} there, {expected!r} here")


def describe(config: Config) -> dict[str, Any]:
    """The sections of the metadata that follow from the configuration and this version of the software."""
    robot, task = get_robot(config.robot), config.task
    grid = HeightGrid(config.observation)
    sections = {
        "robot": _describe_robot(robot),
        "control": {"period_s": config.physics.control_dt},
        "observation": _schema(config, robot),
        "heights": {
            # Rounded, because float32 makes 0.1 a number that no person would write.
            "points_m": [[round(x, 6) for x in point] for point in grid.points.tolist()],
            "step_m": config.observation.grid_step,
            "offset_m": HEIGHT_OFFSET,
            "clip_m": HEIGHT_CLIP,
        },
        "task": {
            "name": task.name,
            "reward_window_s": task.reward_window_s,
            "episode_s": task.episode_s,
            "target_height_m": task.target_height,
            "target_distance_m": list(task.target_distance),
            "arrival_radius_m": task.arrival_radius,
        },
    }
    return json.loads(json.dumps(sections))


def _describe_robot(robot: Robot) -> dict[str, Any]:
    model, motor = robot.build_spec(False).compile(), robot.motor
    return {
        "name": robot.name,
        "joint_names": robot.joint_names,
        "default_joint_pos_rad": robot.default_joint_pos,
        "joint_limits_rad": [model.joint(name).range.tolist() for name in robot.joint_names],
        "action_scale_rad": robot.action_scale,
        "stiffness": motor.stiffness,
        "damping": motor.damping,
        "effort_limit": motor.effort_limit,
        "stall_torque": motor.stall_torque,
        "no_load_speed": motor.no_load_speed,
        "standing_height_m": robot.standing_height,
    }


def _schema(config: Config, robot: Robot) -> list[dict[str, Any]]:
    """The observation's terms, from a task without any robots."""
    nothing = Rasters(*(torch.zeros(1) for _ in fields(Rasters)))
    task = get_task(config.task.name)(config, nothing, torch.Generator())
    return Observer(task.observation_terms(robot), False, torch.device("cpu")).schema()


def _graph(network: nn.Sequential) -> onnx.ModelProto:
    """Gemm and Elu nodes with a free batch size."""
    nodes, weights, value = [], [], INPUT
    layers = [layer for layer in network if not isinstance(layer, nn.Identity)]
    for i, layer in enumerate(layers):
        output = OUTPUT if i == len(layers) - 1 else f"h{i}"
        if isinstance(layer, nn.Linear):
            for name, tensor in ((f"w{i}", layer.weight), (f"b{i}", layer.bias)):
                weights.append(numpy_helper.from_array(tensor.detach().numpy(), name))
            nodes.append(helper.make_node("Gemm", [value, f"w{i}", f"b{i}"], [output], transB=1))
        elif isinstance(layer, nn.ELU):
            nodes.append(helper.make_node("Elu", [value], [output], alpha=float(layer.alpha)))
        else:
            raise ArriveError(f"cannot export a network with a layer {type(layer).__name__}")
        value = output
    linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
    sizes = ((INPUT, linear[0].in_features), (OUTPUT, linear[-1].out_features))
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size]) for name, size in sizes]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], weights)
    opset = helper.make_opsetid("", OPSET)
    return helper.make_model(graph, producer_name="arrive", opset_imports=[opset], ir_version=IR_VERSION)


def _golden(policy: Policy) -> dict[str, Any]:
    """Pairs of standard normal inputs and the training network's outputs; numbers are float32 in full."""
    rng = np.random.default_rng(GOLDEN_SEED)
    observations = rng.standard_normal((GOLDEN_PAIRS, policy.schema[-1]["stop"])).astype(np.float32)
    actions = policy.act(torch.from_numpy(observations))
    return {"seed": GOLDEN_SEED, "observations": observations.tolist(), "actions": actions.tolist()}


def _evaluation(path: Path) -> dict[str, Any] | None:
    """What `arrive eval --protocol difficulty` found, or None where the run was not measured."""
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text())
        return {name: content[name] for name in ("families", "protocol", "commit")}
    except (OSError, json.JSONDecodeError, KeyError) as error:
        raise ArriveError(f"cannot read {path}: {error!r}. Measure the run again.") from error
