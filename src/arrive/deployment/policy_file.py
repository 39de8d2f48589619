"""The exported policy: one ONNX file with all metadata needed to run it. Needs onnxruntime, not torch."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import onnxruntime

from arrive.deployment.onnx_file import PREFIX, OnnxFile, read_onnx_file
from arrive.deployment.plausible import (
    Implausible,
    check_feet,
    check_golden,
    check_grid,
    check_robot,
    check_task,
    check_training,
    positive,
    text,
    texts,
)
from arrive.deployment.specs import GridSpec, RobotSpec, TaskSpec, Term
from arrive.errors import ArriveError, brief
from arrive.kinematics import FootChain, Link

FORMAT = 3
"""Version of the metadata format."""
SECTIONS = ("format", "robot", "control", "observation", "heights", "task", "training", "evaluation", "golden")
INPUT, OUTPUT = "observation", "action"
"""Names of the network's input (batch, observations) and output (batch, joints), float32."""
TOLERANCE = 1e-5
"""Tolerance for golden outputs, relative to the largest of them if that is above 1. float32 has 7 digits."""
LONGEST_PERIOD_S = 1.0


@dataclass(frozen=True, eq=False)
class PolicyFile:
    """An exported policy that has been read and checked."""

    path: Path
    session: onnxruntime.InferenceSession
    meta: dict[str, Any]
    """The metadata, section by section."""
    digest: str
    """SHA-256 of the file's content, which identifies this policy."""
    terms: tuple[Term, ...]
    robot: RobotSpec
    grid: GridSpec
    task: TaskSpec
    period_s: float

    def act(self, observation: np.ndarray) -> np.ndarray:
        """(n, joints) float32 actions for (n, size) float32 scaled observations."""
        return self.session.run([OUTPUT], {INPUT: observation})[0]


def read_policy_file(path: Path | str) -> PolicyFile:
    """Read an exported policy, check its checksum and every value, and recompute its golden pairs.

    Raises:
        ArriveError: the file is missing, truncated, changed, not exported by arrive or of another format, it has
            implausible values, or its network does not reproduce the golden pairs.
    """
    path = Path(path)
    content = read_onnx_file(path)
    meta = _parse(path, content.metadata)
    try:
        file = PolicyFile(
            path,
            _open(path, content),
            meta,
            content.digest,
            terms=tuple(Term(**row) for row in meta["observation"]),
            robot=RobotSpec(**meta["robot"] | {"feet": _feet(meta["robot"].get("feet", []))}),
            grid=GridSpec(**meta["heights"]),
            task=TaskSpec(**meta["task"]),
            period_s=positive("control.period_s", meta["control"]["period_s"], LONGEST_PERIOD_S),
        )
        check_robot(file.robot)
        check_grid(file.grid)
        check_feet(file.robot, file.grid)
        check_task(file.task)
        check_training(meta["training"], meta["evaluation"])
        _check_terms(file)
        _check_sizes(file)
        _check_golden(file)
    except Implausible as problem:
        fault = brief(str(problem))
        raise ArriveError(f"{path} is implausible: {fault}. Export the policy again.") from problem
    except (TypeError, ValueError, KeyError, AttributeError, IndexError, OverflowError) as error:
        fault = brief(repr(error))
        raise ArriveError(f"the metadata of {path} is damaged: {fault}. Export the policy again.") from error
    return file


def _feet(rows: list[dict[str, Any]]) -> tuple[FootChain, ...]:
    return tuple(FootChain(**row | {"links": [Link(**link) for link in row["links"]]}) for row in rows)


def _open(path: Path, file: OnnxFile) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    # Threads cost more than they save at this size, and a spinning one takes a core from the robot.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(file.content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # whatever a network that is none makes onnxruntime raise
        raise ArriveError(
            f"onnxruntime cannot run {path} ({type(error).__name__}). Export the policy again with `arrive export`, "
            "or install a newer onnxruntime."
        ) from error


def _parse(path: Path, text: dict[str, str]) -> dict[str, Any]:
    if PREFIX + "format" not in text:
        raise ArriveError(f"{path} is an ONNX file but not a policy of arrive: it has no metadata of `arrive export`")
    if text[PREFIX + "format"] != str(FORMAT):
        raise ArriveError(f"{path} has export format {brief(text[PREFIX + 'format'])}, this version reads {FORMAT}")
    missing = [name for name in SECTIONS if PREFIX + name not in text]
    if missing:
        raise ArriveError(f"{path} lacks the metadata {', '.join(missing)}. Export the policy again.")
    try:
        return {name: _json(text[PREFIX + name]) for name in SECTIONS}
    except (ValueError, RecursionError) as error:
        raise ArriveError(
            f"the metadata of {path} is damaged: {brief(str(error))}. Export the policy again."
        ) from error


def _json(text: str) -> Any:
    """Strict JSON: finite numbers, and no key twice."""
    return json.loads(text, parse_constant=_no_number, parse_float=_finite, object_pairs_hook=_once)


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _no_number(text)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        twice = next(key for i, (key, _) in enumerate(pairs) if key in dict(pairs[:i]))
        raise ValueError(f"the key {twice!r} is there twice")
    return content


def _check_terms(file: PolicyFile) -> None:
    """Check that slices have texts, distinct names, no gaps and positive scales."""
    for i, term in enumerate(file.terms):
        text(f"observation[{i}].name", term.name)
        text(f"observation[{i}].unit", term.unit, least=0)
        text(f"observation[{i}].frame", term.frame, least=0)
        texts(f"observation[{i}].labels", term.labels)
    if len({term.name for term in file.terms}) != len(file.terms):
        raise Implausible("two observations have the same name")
    end = 0
    for term in file.terms:
        whole = type(term.start) is int and type(term.stop) is int
        if not whole or not term.start == end < term.stop or term.stop - term.start != len(term.labels):
            raise Implausible(f"the slice of observation {term.name!r} does not follow the one before")
        positive(f"the scale of observation {term.name!r}", term.scale)
        end = term.stop


def _check_sizes(file: PolicyFile) -> None:
    """Check that all sizes agree with the network."""
    inputs, outputs = file.session.get_inputs(), file.session.get_outputs()
    if [x.name for x in inputs] != [INPUT] or [x.name for x in outputs] != [OUTPUT]:
        raise Implausible(f"its network must map {INPUT!r} to {OUTPUT!r} and nothing else")
    for what, size, expected in (
        ("observations", inputs[0].shape[-1], file.terms[-1].stop),
        ("actions", outputs[0].shape[-1], len(file.robot.joint_names)),
    ):
        if size != expected:
            raise Implausible(f"its network has {size} {what}, but its metadata requires {expected}")


def _check_golden(file: PolicyFile) -> None:
    observations, expected = check_golden(file.meta["golden"], file.terms[-1].stop, len(file.robot.joint_names))
    try:
        found = file.act(observations)
    except Exception as error:  # whatever a network that is none makes onnxruntime raise
        raise Implausible(f"its network does not run ({type(error).__name__})") from error
    deviation = np.abs(found - expected).max() / max(1.0, np.abs(expected).max())
    if not deviation <= TOLERANCE:
        raise ArriveError(
            f"{file.path} does not reproduce its golden pairs: golden actions differ by "
            f"{deviation:.2g}, more than {TOLERANCE:g}. The network was changed, or onnxruntime does not work here."
        )
