"""The exported policy: one ONNX file whose metadata says all that running it takes. Needs onnxruntime, not torch."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from arrive.errors import ArriveError

FORMAT = 1
"""Version of the metadata's layout."""
PREFIX = "arrive."
"""Every metadata key begins with this; each value is JSON."""
SECTIONS = (
    "format",
    "robot",
    "control",
    "observation",
    "heights",
    "task",
    "training",
    "evaluation",
    "golden",
    "weights",
)
DIGEST = "digest"
"""Section with the SHA-256 of all the others."""
INPUT, OUTPUT = "observation", "action"
"""Names of the network's input (batch, observations) and output (batch, joints), float32."""
TOLERANCE = 1e-5
"""Golden outputs must be met within this, in units of the largest of them if that is above 1: float32 has 7 digits."""


@dataclass(frozen=True)
class Term:
    """One named slice of the observation."""

    name: str
    start: int
    stop: int
    unit: str
    frame: str
    scale: float
    """The network receives value * scale."""
    labels: list[str]


@dataclass(frozen=True)
class RobotSpec:
    """What the controller must know of the robot; lists are in the order of `joint_names`."""

    name: str
    joint_names: list[str]
    default_joint_pos_rad: list[float]
    joint_limits_rad: list[list[float]]
    """Lowest and highest position of each joint."""
    action_scale_rad: float
    """Joint target = default position + this * action."""
    stiffness: float
    """Proportional gain the drives must run with [N m/rad]."""
    damping: float
    """Derivative gain the drives must run with [N m s/rad]."""
    effort_limit: float
    """[N m]."""
    stall_torque: float
    """[N m]."""
    no_load_speed: float
    """[rad/s]."""
    standing_height_m: float
    """Base above flat ground at the default pose."""


@dataclass(frozen=True)
class GridSpec:
    """Where the network wants to know the ground's height."""

    points_m: list[list[float]]
    """x forward and y left of the base, horizontal, turned with its heading."""
    step_m: float
    offset_m: float
    """Heights are relative to this far below the base, positive down."""
    clip_m: float
    """Relative heights are cut at plus and minus this."""


@dataclass(frozen=True)
class TaskSpec:
    """What the policy was trained to do."""

    name: str
    reward_window_s: float
    episode_s: float
    target_height_m: float
    """Targets were this high above the ground."""
    target_distance_m: list[float]
    """Nearest and farthest target."""
    arrival_radius_m: float


@dataclass(frozen=True, eq=False)
class PolicyFile:
    """An exported policy that has been read and checked."""

    path: Path
    session: onnxruntime.InferenceSession
    meta: dict[str, Any]
    """The metadata, section by section."""
    terms: tuple[Term, ...]
    robot: RobotSpec
    grid: GridSpec
    task: TaskSpec
    period_s: float

    def act(self, observation: np.ndarray) -> np.ndarray:
        """(n, joints) float32 actions for (n, size) float32 scaled observations."""
        return self.session.run([OUTPUT], {INPUT: observation})[0]


def digest(metadata: Mapping[str, str]) -> str:
    """SHA-256 over all sections but the digest itself, in the order of their names."""
    whole = hashlib.sha256()
    for key in sorted(metadata):
        if key.startswith(PREFIX) and key != PREFIX + DIGEST:
            whole.update(f"{key}\0{metadata[key]}\0".encode())
    return whole.hexdigest()


def read_policy_file(path: Path | str) -> PolicyFile:
    """Read an exported policy and recompute its golden pairs.

    Raises:
        ArriveError: missing, truncated, not an export of arrive, of another format, changed since it was written, or
            it does not compute here what it computed where it was exported.
    """
    path = Path(path)
    session = _open(path)
    text = session.get_modelmeta().custom_metadata_map
    meta = _parse(path, text)
    try:
        file = PolicyFile(
            path,
            session,
            meta,
            terms=tuple(Term(**row) for row in meta["observation"]),
            robot=RobotSpec(**meta["robot"]),
            grid=GridSpec(**meta["heights"]),
            task=TaskSpec(**meta["task"]),
            period_s=float(meta["control"]["period_s"]),
        )
        _check_sizes(file)
        _check_golden(file)
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise ArriveError(f"the metadata of {path} is damaged: {error!r}. Export the policy again.") from error
    return file


def _open(path: Path) -> onnxruntime.InferenceSession:
    if not path.is_file():
        raise ArriveError(f"there is no file {path}")
    options = onnxruntime.SessionOptions()
    # Threads cost more than they save at this size, and a spinning one takes a core from the robot.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # whatever damaged bytes make onnxruntime raise
        raise ArriveError(
            f"cannot read {path}: it is truncated, corrupt or no ONNX file ({type(error).__name__}). "
            "Export the policy again with `arrive export`."
        ) from error


def _parse(path: Path, text: Mapping[str, str]) -> dict[str, Any]:
    if PREFIX + "format" not in text:
        raise ArriveError(f"{path} is an ONNX file but no policy of arrive: it lacks the metadata of `arrive export`")
    if text[PREFIX + "format"] != str(FORMAT):
        raise ArriveError(f"{path} has export format {text[PREFIX + 'format']}, this version reads {FORMAT}")
    missing = [name for name in (*SECTIONS, DIGEST) if PREFIX + name not in text]
    if missing:
        raise ArriveError(f"{path} lacks the metadata {', '.join(missing)}. Export the policy again.")
    try:
        meta = {name: json.loads(text[PREFIX + name]) for name in (*SECTIONS, DIGEST)}
    except json.JSONDecodeError as error:
        raise ArriveError(f"the metadata of {path} is damaged: {error}. Export the policy again.") from error
    if meta[DIGEST] != digest(text):
        raise ArriveError(f"the metadata of {path} was changed after the export. Export the policy again.")
    return meta


def _check_sizes(file: PolicyFile) -> None:
    """Slices join without gaps, and every size agrees with the network's."""
    inputs, outputs = file.session.get_inputs(), file.session.get_outputs()
    if [x.name for x in inputs] != [INPUT] or [x.name for x in outputs] != [OUTPUT]:
        raise ArriveError(f"the network in {file.path} must map {INPUT!r} to {OUTPUT!r} and nothing else")
    end = 0
    for term in file.terms:
        if term.start != end or term.stop - term.start != len(term.labels):
            raise ArriveError(f"the slice of observation {term.name!r} in {file.path} does not follow the one before")
        end = term.stop
    joints = len(file.robot.joint_names)
    for what, size, expected in (
        ("observations", inputs[0].shape[-1], end),
        ("actions", outputs[0].shape[-1], joints),
        ("default positions", len(file.robot.default_joint_pos_rad), joints),
        ("joint limits", len(file.robot.joint_limits_rad), joints),
    ):
        if size != expected:
            raise ArriveError(f"{file.path} has {size} {what} where its metadata asks for {expected}")


def _check_golden(file: PolicyFile) -> None:
    golden = file.meta["golden"]
    observations = np.array(golden["observations"], dtype=np.float32)
    expected = np.array(golden["actions"], dtype=np.float32)
    error = np.abs(file.act(observations) - expected).max() / max(1.0, np.abs(expected).max())
    if not error <= TOLERANCE:
        raise ArriveError(
            f"{file.path} does not compute what it computed when it was exported: golden actions differ by "
            f"{error:.2g}, more than {TOLERANCE:g}. The network was changed, or onnxruntime does not work here."
        )
