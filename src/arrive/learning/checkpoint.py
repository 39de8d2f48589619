"""Checkpoint and policy files. A digest in the file is checked when it is read, and nothing in it is executed."""

import hashlib
import io
import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from arrive.config import Config, saved_config, to_dict
from arrive.errors import ArriveError
from arrive.files import read_bytes, write_bytes
from arrive.policies import POLICY_NAME
from arrive.terms import same_labels

FORMAT = 2
"""Version of the file format."""
CHECKPOINT_NAME = "checkpoint.pt"
SEAL = b"arrive sha256 "
"""A file ends with this and the hexadecimal SHA-256 of all bytes before it, as the comment of torch's zip file."""
DIGEST_BYTES = 64
WEIGHT_TYPE = torch.float32
"""Type of every weight and of the optimiser's moments."""
MAP_TYPE = torch.int64
MAPS = ("facing.observation_index", "facing.action_index", "facing.side")
"""The index tensors of a symmetric network. They are integers."""


@dataclass(frozen=True)
class Origin:
    """Where a checkpoint or policy file comes from."""

    robot: str
    config: Config
    schema: list[dict[str, Any]]
    """Terms of the observation that the networks use, see `Observer.schema`."""
    commit: str
    """Commit of the code that trained it."""
    iteration: int
    samples: int
    """Policy steps it was trained for."""

    def content(self) -> dict[str, Any]:
        """As plain data, as stored in a file."""
        return {"format": FORMAT, **vars(self), "config": to_dict(self.config)}


def append_digest(data: bytes) -> bytes:
    """Add the digest of a zip file without a comment, as torch writes it, as its comment."""
    body = data[:-2] + struct.pack("<H", len(SEAL) + DIGEST_BYTES) + SEAL
    return body + hashlib.sha256(body).hexdigest().encode()


def is_sealed(data: bytes) -> bool:
    """Whether the file ends with the digest of its other bytes, so that no bit has changed since it was written."""
    body, digest = data[:-DIGEST_BYTES], data[-DIGEST_BYTES:]
    return body.endswith(SEAL) and hashlib.sha256(body).hexdigest().encode() == digest


def save_sealed(content: dict[str, Any], path: Path) -> None:
    """Write tensors and plain data with a digest, atomically.

    Raises:
        ArriveError: the folder cannot be written or the disk is full.
    """
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_bytes(path, append_digest(buffer.getvalue()))


def load_policy_file(path: Path) -> tuple[Origin, dict[str, Tensor]]:
    """Read the origin of a policy and its actor's weights.

    Raises:
        ArriveError: the file is missing, damaged, not from arrive or a training checkpoint, or a weight is not finite.
    """
    origin, content = _load(path)
    if "actor" not in content:
        raise ArriveError(f"{path} is a training checkpoint without a policy; use {POLICY_NAME} beside it")
    _check_weights(content["actor"], path)
    return origin, content["actor"]


def load_checkpoint(path: Path) -> tuple[Origin, dict[str, Any]]:
    """Read the origin of a training checkpoint and the state of the training.

    Raises:
        ArriveError: the file is missing, damaged, not from arrive or only a policy, or a weight is not finite.
    """
    origin, content = _load(path)
    if "state" not in content:
        raise ArriveError(f"{path} is a policy, not a training checkpoint; training cannot resume or start from it")
    state = content["state"]
    if not isinstance(state, dict) or not isinstance(state.get("algorithm"), dict):
        raise _foreign(path, "it has no networks")
    _check_weights(state["algorithm"], path)
    return origin, state


def _load(path: Path) -> tuple[Origin, dict[str, Any]]:
    """A file's origin and its content."""
    path = Path(path)
    if not os.path.lexists(path):
        raise ArriveError(f"there is no file {path}")
    data = read_bytes(path)
    if not is_sealed(data):
        raise ArriveError(
            f"cannot read {path}: it is truncated, corrupt or not a checkpoint of arrive (its digest does not match). "
            f"Use an earlier copy or train again."
        )
    try:
        content = torch.load(io.BytesIO(data), weights_only=True, map_location="cpu")
    except Exception as error:  # on unknown bytes, torch and its unpickler may raise anything
        raise _foreign(path, type(error).__name__) from error
    return _origin(content, path), content


def _origin(content: Any, path: Path) -> Origin:
    if not isinstance(content, dict) or "format" not in content:
        raise _foreign(path, "it has no format")
    if content["format"] != FORMAT:
        raise ArriveError(
            f"{path} was made by another version of arrive (checkpoint format {content['format']!r}, this version "
            f"reads {FORMAT}): use that version, or train again"
        )
    kinds = {"robot": str, "config": dict, "schema": list, "commit": str, "iteration": int, "samples": int}
    for name, kind in kinds.items():
        if not isinstance(content.get(name), kind):
            raise _foreign(path, f"its {name} must be {kind.__name__}, not {content.get(name)!r:.60}")
    rows = content["schema"]
    if not rows or not all(isinstance(row, dict) and isinstance(row.get("stop"), int) for row in rows):
        raise _foreign(path, "its schema must be a list of rows with their `stop`")
    return Origin(**{name: content[name] for name in kinds} | {"config": saved_config(content["config"], path)})


def _foreign(path: Path, why: str) -> ArriveError:
    return ArriveError(f"{path} is not a checkpoint of arrive: {why}")


def _check_weights(weights: Any, path: Path) -> None:
    """Check that every tensor is float32 and finite.

    Raises:
        ArriveError: names the first tensor that is not.
    """
    if not isinstance(weights, Mapping) or not weights:
        raise _foreign(path, "it has no weights")
    for name, value in _tensors(weights):
        expected = MAP_TYPE if name.endswith(MAPS) else WEIGHT_TYPE
        if value.dtype != expected:
            raise ArriveError(f"{path} is damaged: {name} is {value.dtype}, not {expected}. Use an earlier copy.")
        if not bool(value.isfinite().all()):
            raise ArriveError(f"{path} is damaged: {name} has values that are not finite. Use an earlier copy.")


def _tensors(value: Any, name: str = "") -> Iterator[tuple[str, Tensor]]:
    """Every tensor in nested data, with its path."""
    if isinstance(value, Tensor):
        yield name, value
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _tensors(item, f"{name}.{key}".lstrip("."))


def check_fits(origin: Origin, robot: str, schema: list[dict[str, Any]], path: Path) -> None:
    """Check that networks of this origin fit a robot and its observation.

    Raises:
        ArriveError: they are for another robot or observation.
    """
    if origin.robot != robot:
        raise ArriveError(f"{path} was trained for the robot {origin.robot!r}, not {robot!r}")
    check_schema(origin.schema, schema, path)


def check_schema(saved: list[dict[str, Any]], present: list[dict[str, Any]], path: Path) -> None:
    """Check that a policy gets the observation it was trained on.

    Raises:
        ArriveError: the schemas differ; the message names the first term that differs.
    """
    for ours, theirs in zip(present, saved, strict=False):
        if keys := _differing(ours, theirs):
            raise ArriveError(
                f"{path} was trained on another observation: its term {theirs.get('name')!r} and {ours['name']!r} here "
                f"differ in {', '.join(keys)}. Use the configuration and version it was trained with."
            )
    if len(saved) != len(present):
        raise ArriveError(
            f"{path} was trained on {len(saved)} observation terms, this configuration has {len(present)}"
        )


def _differing(ours: dict[str, Any], theirs: dict[str, Any]) -> list[str]:
    """The keys in which two rows of a schema differ in meaning."""
    keys = [key for key in ours | theirs if ours.get(key) != theirs.get(key)]
    if "labels" in keys and same_labels(theirs.get("labels"), ours["labels"]):
        keys.remove("labels")
    return keys
