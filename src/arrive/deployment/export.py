"""Writes a trained policy as one self-describing ONNX file, and compares such a file with this version."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

from arrive.config import Config, saved_config, to_dict
from arrive.deployment.onnx_file import PREFIX, append_checksum
from arrive.deployment.policy_file import FORMAT, INPUT, OUTPUT, PolicyFile, read_policy_file
from arrive.deployment.specs import MOTOR_FIGURES
from arrive.errors import ArriveError, brief
from arrive.files import whole
from arrive.learning.checkpoint import check_schema
from arrive.learning.networks import Facing, Network
from arrive.learning.policy import Policy
from arrive.policies import DIFFICULTY_NAME
from arrive.results.read import read_if_there
from arrive.robots import get_robot
from arrive.robots.legs import foot_chains
from arrive.robots.robot import Robot
from arrive.task.final import FinalConfig, PositionConfig
from arrive.task.heights import FootGrid, HeightGrid
from arrive.task.observations import Observer, height_offset
from arrive.task.registry import get_task
from arrive.terms import same_label

OPSET, IR_VERSION = 17, 8
"""Supported by every onnxruntime since 1.13."""
GOLDEN_PAIRS, GOLDEN_SEED = 16, 0


def export_policy(policy: Policy, out: Path) -> None:
    """Write a policy with everything needed to run it. The file is read back before it replaces an existing one.

    Raises:
        ArriveError: the policy was trained on another observation than this version's, its networks are of an unknown
            kind, its values are implausible, or the file cannot be written.
    """
    sections = policy_sections(policy.config)
    check_schema(policy.schema, sections["observation"], policy.path)
    sections |= {
        "format": FORMAT,
        "training": {"config": to_dict(policy.config), "commit": policy.commit, "samples": policy.samples},
        "evaluation": _evaluation(policy.path.parent / DIFFICULTY_NAME),
        "golden": _golden(policy),
    }
    model = _model(policy.actor)
    helper.set_model_props(model, {PREFIX + name: json.dumps(value) for name, value in sections.items()})
    onnx.checker.check_model(model)
    with whole(out) as file:
        file.write_bytes(append_checksum(model.SerializeToString()))
        read_policy_file(file)


def compare_with_this_version(file: PolicyFile) -> None:
    """Check that a file's robot, observation, grid, period and task agree with those of this version.

    Raises:
        ArriveError: they differ; the message names the first difference.
    """
    config = saved_config(file.meta["training"]["config"], file.path)
    for section, expected in policy_sections(config).items():
        _compare(file.path, section, file.meta[section], expected)


def _compare(path: Path, where: str, found: Any, expected: Any) -> None:
    """Raise an error that names the first difference."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for name in expected | found:
            _compare(path, f"{where}.{name}", found.get(name), expected.get(name))
    elif isinstance(expected, list) and isinstance(found, list) and len(found) == len(expected):
        for i, pair in enumerate(zip(found, expected, strict=True)):
            _compare(path, f"{where}[{i}]", *pair)
    elif found != expected and not (".labels[" in where and same_label(found, expected)):
        raise ArriveError(
            f"{path} does not fit this version of arrive: {where} is {brief(repr(found))}, not {brief(repr(expected))}"
        )


def policy_sections(config: Config) -> dict[str, Any]:
    """The sections of the metadata that follow from the configuration and this version of arrive."""
    robot, heights, feet = get_robot(config.robot), config.observation.heights, config.observation.foot_heights
    # The format requires targets. For a task without targets, they are those of the paper.
    task = config.task if isinstance(config.task, PositionConfig) else FinalConfig()
    grid = HeightGrid(heights)
    sections = {
        "robot": _describe_robot(robot) | ({"feet": list(map(asdict, foot_chains(robot)))} if feet.enabled else {}),
        "control": {"period_s": config.physics.control_dt},
        "observation": _schema(config, robot),
        "heights": {
            "points_m": _points(grid.points),
            "step_m": heights.step / heights.samples,
            "offset_m": height_offset(robot),
            "clip_m": list(heights.clip),
            **({"samples": heights.samples} if heights.samples > 1 else {}),
            **({"foot_points_m": _points(FootGrid(feet).offsets)} if feet.enabled else {}),
        },
        "task": {
            "name": config.task.name,
            "reward_window_s": task.reward_window_s,
            "episode_s": config.task.episode_s,
            "target_height_m": task.target_height,
            "target_distance_m": list(task.target_distance),
            "arrival_radius_m": task.arrival_radius,
        },
    }
    return json.loads(json.dumps(sections))


def _describe_robot(robot: Robot) -> dict[str, Any]:
    return {
        "name": robot.name,
        "joint_names": robot.joint_names,
        "default_joint_pos_rad": robot.default_joint_pos,
        "joint_limits_rad": [robot.model.joint(name).range.tolist() for name in robot.joint_names],
        "action_scale_rad": robot.action_scale,
        **{name: _one_or_each([getattr(motor, name) for motor in robot.motors]) for name in MOTOR_FIGURES},
        "standing_height_m": robot.standing_height,
    }


def _points(points: Tensor) -> list[list[float]]:
    """Rounded, because in float32 0.1 has many digits."""
    return [[round(x, 6) for x in point] for point in points.tolist()]


def _one_or_each(values: list[float]) -> float | list[float]:
    """The value that all joints share, or a list with one value per joint."""
    return values[0] if len(set(values)) == 1 else values


def _schema(config: Config, robot: Robot) -> list[dict[str, Any]]:
    """The observation's terms, as training has them."""
    terms = get_task(config.task.name).observation_terms(config.task, config.observation, robot)
    return Observer(terms, False, torch.device("cpu")).schema()


class _Graph:
    """An ONNX graph under construction: constants and nodes."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[TensorProto] = []

    def constant(self, name: str, value: Tensor) -> str:
        self.constants.append(numpy_helper.from_array(value.detach().cpu().numpy(), name))
        return name

    def node(self, operator: str, inputs: list[str], output: str, **attributes: Any) -> str:
        self.nodes.append(helper.make_node(operator, inputs, [output], **attributes))
        return output


def _model(network: Network) -> onnx.ModelProto:
    """The network with a free batch size."""
    graph = _Graph()
    value = INPUT
    needed: list[str] = []
    if network.facing is not None:
        value, needed = _reflect_observation(graph, network.facing)
    value = _layers(graph, network.mlp, value)
    if network.facing is not None:
        value = _reflect_action(graph, network.facing, value, needed)
    graph.nodes[-1].output[0] = OUTPUT
    linear = [layer for layer in network.mlp if isinstance(layer, nn.Linear)]
    sizes = ((INPUT, linear[0].in_features), (OUTPUT, linear[-1].out_features))
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size]) for name, size in sizes]
    made = helper.make_graph(graph.nodes, "policy", ends[:1], ends[1:], graph.constants)
    opset = helper.make_opsetid("", OPSET)
    return helper.make_model(made, producer_name="arrive", opset_imports=[opset], ir_version=IR_VERSION)


def _layers(graph: _Graph, network: nn.Sequential, value: str) -> str:
    """Gemm and Elu nodes."""
    layers = [layer for layer in network if not isinstance(layer, nn.Identity)]
    for i, layer in enumerate(layers):
        if isinstance(layer, nn.Linear):
            weights = graph.constant(f"w{i}", layer.weight), graph.constant(f"b{i}", layer.bias)
            value = graph.node("Gemm", [value, *weights], f"h{i}", transB=1)
        elif isinstance(layer, nn.ELU):
            value = graph.node("Elu", [value], f"h{i}", alpha=float(layer.alpha))
        else:
            raise ArriveError(f"cannot export a network with a layer {type(layer).__name__}")
    return value


def _reflect_observation(graph: _Graph, facing: Facing) -> tuple[str, list[str]]:
    """As `Facing.observation`. Also returns the names of the flags for the applied reflections."""
    value, needed = INPUT, []
    zero = graph.constant("zero", torch.zeros(1))
    for row in range(len(facing.side)):
        side = graph.constant(f"side{row}", facing.side[row : row + 1])
        column = graph.node("Gather", [value, side], f"column{row}", axis=1)
        needed.append(graph.node("Less", [column, zero], f"needed{row}"))
        maps = facing.observation_index[row], facing.observation_sign[row]
        value = _reflect(graph, f"o{row}", value, maps, needed[-1])
    return value, needed


def _reflect_action(graph: _Graph, facing: Facing, value: str, needed: list[str]) -> str:
    """As `Facing.action`."""
    for row in reversed(range(len(needed))):
        value = _reflect(graph, f"a{row}", value, (facing.action_index[row], facing.action_sign[row]), needed[row])
    return value


def _reflect(graph: _Graph, name: str, value: str, maps: tuple[Tensor, Tensor], needed: str) -> str:
    index, sign = graph.constant(f"{name}_index", maps[0]), graph.constant(f"{name}_sign", maps[1])
    moved = graph.node("Gather", [value, index], f"{name}_moved", axis=1)
    reflected = graph.node("Mul", [moved, sign], f"{name}_reflected")
    return graph.node("Where", [needed, reflected, value], name)


def _golden(policy: Policy) -> dict[str, Any]:
    """Pairs of standard normal inputs and the training network's outputs, with all digits of float32."""
    rng = np.random.default_rng(GOLDEN_SEED)
    observations = rng.standard_normal((GOLDEN_PAIRS, policy.schema[-1]["stop"])).astype(np.float32)
    actions = policy.act(torch.from_numpy(observations))
    return {"seed": GOLDEN_SEED, "observations": observations.tolist(), "actions": actions.tolist()}


def _evaluation(path: Path) -> dict[str, Any] | None:
    """Result of `arrive eval --protocol difficulty`, or None if the run was not evaluated."""
    content = read_if_there(path, "difficulty")
    return content and {name: content[name] for name in ("families", "protocol", "commit")}
