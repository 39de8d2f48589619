"""Reads the bytes of an exported policy without the `onnx` package, and checks its checksum.

An ONNX file is a Protocol Buffers message (onnx.proto3, field numbers below). An exported policy uses only a small part
of the format: a few operators, weights inside the file, and metadata. Everything else is refused before onnxruntime
sees it: external data, other operators, other fields, and sizes beyond that of the file.
"""

import hashlib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from arrive.errors import ArriveError

PREFIX = "arrive."
"""Prefix of every metadata key. Each value is JSON."""
SEAL = "sha256"
"""The last metadata entry: the SHA-256 of all bytes before it."""
OPERATORS = ("Gemm", "Elu", "Gather", "Less", "Mul", "Where")
"""Layers, and the reflections of a symmetric network."""
LARGEST_FILE = 256 * 2**20
"""Larger files are refused. A policy file has some hundred kB [bytes]."""

VARINT, BYTES, FIXED32 = 0, 2, 5
NUMBER_TYPES: dict[int, np.dtype[Any]] = {1: np.dtype("<f4"), 7: np.dtype("<i8")}
"""TensorProto.DataType: FLOAT for weights and INT64 for indices."""
MODEL = {1: "ir_version", 2: "producer_name", 3: "producer_version", 4: "domain", 5: "model_version", 6: "doc_string",
         7: "graph", 8: "opset_import", 14: "metadata_props"}  # fmt: skip
GRAPH = {1: "node", 2: "name", 5: "initializer", 10: "doc_string", 11: "input", 12: "output"}
NODE = {1: "input", 2: "output", 3: "name", 4: "op_type", 5: "attribute", 6: "doc_string", 7: "domain"}
ATTRIBUTE = {1: "name", 2: "f", 3: "i", 20: "type"}
ATTRIBUTES = {"Gemm": {"transB"}, "Elu": {"alpha"}, "Gather": {"axis"}}
TENSOR = {1: "dims", 2: "data_type", 8: "name", 9: "raw_data", 14: "data_location"}
OPSET = {1: "domain", 2: "version"}
ENTRY = {1: "key", 2: "value"}
NUMBERS = {"ir_version", "model_version", "version", "i", "type", "dims", "data_type", "data_location"}
"""Integer fields. `f` is a float32, and all others are bytes."""
REFUSED = {
    "TensorProto": {13: "external data"},
    "ModelProto": {20: "training information", 25: "functions of its own"},
    "AttributeProto": {5: "a tensor", 6: "a graph"},
}
"""Fields that get their own message when they are refused."""


class Damaged(Exception):
    """The bytes are not an exported policy. The message says why."""


@dataclass(frozen=True, eq=False)
class OnnxFile:
    """Content of an exported policy."""

    content: bytes
    metadata: dict[str, str]
    """Metadata without the checksum."""
    weights: dict[str, np.ndarray]
    """Weights (float32) and indices (int64) by name."""
    digest: str
    """The file's SHA-256 in hexadecimal."""


def append_checksum(content: bytes) -> bytes:
    """Append a model's checksum to it, as the last entry of its metadata."""
    return content + _seal_of(content)


def _seal_of(content: bytes) -> bytes:
    key, value = (PREFIX + SEAL).encode(), f'"{hashlib.sha256(content).hexdigest()}"'.encode()
    entry = b"\x0a" + bytes([len(key)]) + key + b"\x12" + bytes([len(value)]) + value
    return b"\x72" + bytes([len(entry)]) + entry  # field 14, metadata_props


def read_onnx_file(path: Path) -> OnnxFile:
    """Read the bytes of an exported policy, and check that they are unchanged and harmless.

    Raises:
        ArriveError: the file is missing, changed, truncated or not from arrive, or has content that no exported policy
            has.
    """
    content = _read(path)
    body = _sealed_body(path, content)
    try:
        metadata, weights = _read_model(memoryview(body))
    except (Damaged, UnicodeDecodeError) as problem:
        raise ArriveError(f"{path} is refused: {problem}. Export the policy again with `arrive export`.") from problem
    return OnnxFile(content, metadata, weights, hashlib.sha256(body).hexdigest())


def _read(path: Path) -> bytes:
    if not path.is_file():
        raise ArriveError(f"there is no file {path}")
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise ArriveError(f"{path} has {size / 1e6:.0f} MB; a policy has less than {LARGEST_FILE / 1e6:.0f} MB")
        return path.read_bytes()
    except OSError as error:
        raise ArriveError(f"cannot read {path}: {error}") from error


def _sealed_body(path: Path, content: bytes) -> bytes:
    """All bytes before the checksum."""
    size = len(_seal_of(b""))
    body = content[:-size]
    if len(content) > size and content == body + _seal_of(body):
        return body
    export = re.search(rb"arrive\.format\x12.(\d{1,9})", content)
    if not export:
        raise ArriveError(
            f"{path} is not a policy of arrive: it is truncated, corrupt, or was not written by `arrive export`"
        )
    if PREFIX.encode() + SEAL.encode() not in content:
        raise ArriveError(
            f"{path} is truncated, or of another version of arrive (export format {export[1].decode()}). "
            "Export the policy again."
        )
    raise ArriveError(f"{path} was changed after the export: its checksum differs. Export the policy again.")


def _read_model(body: memoryview) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    metadata, weights, graphs = {}, {}, 0
    for name, value in _fields(body, MODEL, "ModelProto"):
        if name == "graph":
            graphs += 1
            weights = _read_graph(_bytes(value))
        elif name == "opset_import" and _one(_bytes(value), OPSET, "OperatorSetIdProto").get("domain"):
            raise Damaged("it asks for foreign operators")
        elif name == "metadata_props":
            entry = _one(_bytes(value), ENTRY, "StringStringEntryProto")
            key = bytes(entry.get("key", b"")).decode()
            if key in metadata:
                raise Damaged(f"its metadata has {key!r} twice")
            metadata[key] = bytes(entry.get("value", b"")).decode()
    if graphs != 1:
        raise Damaged(f"it has {graphs} networks")
    return metadata, weights


def _read_graph(graph: memoryview) -> dict[str, np.ndarray]:
    """The weights of a graph. Its nodes are only checked."""
    weights, nodes = {}, []
    for name, value in _fields(graph, GRAPH, "GraphProto"):
        if name == "node":
            nodes.append(_read_node(_bytes(value)))
        elif name == "initializer":
            label, array = _read_tensor(_bytes(value))
            if label in weights:
                raise Damaged(f"it has two weights {label!r}")
            weights[label] = array
    for operator, inputs in nodes:
        _check_growth(operator, inputs, weights)
    return weights


def _read_node(node: memoryview) -> tuple[str, list[str]]:
    """Operator and inputs of a node."""
    operator, inputs, attributes = "", [], {}
    for name, value in _fields(node, NODE, "NodeProto"):
        if name == "op_type":
            operator = bytes(value).decode()
        elif name == "input":
            inputs.append(bytes(value).decode())
        elif name == "domain" and value:
            raise Damaged("it has a foreign operator")
        elif name == "attribute":
            attribute = _one(_bytes(value), ATTRIBUTE, "AttributeProto")
            attributes[bytes(attribute.get("name", b"")).decode()] = attribute.get("i")
    if operator not in OPERATORS:
        raise Damaged(f"it has the operator {operator!r}, policies have {', '.join(OPERATORS)}")
    if not attributes.keys() <= ATTRIBUTES.get(operator, set()) or (operator == "Gather" and attributes != {"axis": 1}):
        raise Damaged(f"its operator {operator} has other attributes than those of a policy")
    return operator, inputs


def _check_growth(operator: str, inputs: list[str], weights: dict[str, np.ndarray]) -> None:
    """Refuse graphs whose intermediate values could be much larger than the file.

    Every value must depend on the batch, so that its size is never a product of two sizes from the file: matrices may
    only be weights of layers, and no node may work on constants alone.
    """
    if not inputs or all(name in weights for name in inputs) or (operator == "Gather" and inputs[0] in weights):
        raise Damaged(f"its operator {operator} works on constants")
    for place, name in enumerate(inputs):
        if name in weights and weights[name].ndim != (2 if (operator, place) == ("Gemm", 1) else 1):
            raise Damaged(f"the weights {name!r} have {weights[name].ndim} dimensions")


def _read_tensor(tensor: memoryview) -> tuple[str, np.ndarray]:
    """Name and values of weights or indices. Their data must be in the file."""
    dims: list[int] = []
    one: dict[str, int | memoryview] = {}
    for name, value in _fields(tensor, TENSOR, "TensorProto"):
        if name == "dims":
            # Several in one field, or one field each.
            dims += _varints(value) if isinstance(value, memoryview) else [value]
        else:
            one[name] = value
    label, data = bytes(one.get("name", b"")).decode(), one.get("raw_data")
    if one.get("data_location", 0) != 0:
        raise Damaged(f"the weights {label!r} are external data")
    code = one.get("data_type")
    kind = NUMBER_TYPES.get(code) if isinstance(code, int) else None
    if kind is None or not isinstance(data, memoryview):
        raise Damaged(f"the weights {label!r} are neither 32-bit floating-point numbers nor 64-bit indices")
    if not all(dims) or len(data) != kind.itemsize * math.prod(dims):
        raise Damaged(f"the weights {label!r} are declared as {dims}, their data have {len(data)} bytes")
    array = np.frombuffer(data, dtype=kind).reshape(dims)
    if not np.isfinite(array).all():
        raise Damaged(f"the weights {label!r} are not finite")
    return label, array


def _one(message: memoryview, known: dict[int, str], kind: str) -> dict[str, int | memoryview]:
    """The fields of a message in which every field occurs at most once."""
    values: dict[str, int | memoryview] = {}
    for name, value in _fields(message, known, kind):
        if name in values:
            raise Damaged(f"a {kind} has {name} twice")
        values[name] = value
    return values


def _fields(message: memoryview, known: dict[int, str], kind: str) -> Iterator[tuple[str, int | memoryview]]:
    """Name and value of every field of a Protocol Buffers message. Unknown fields are refused."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        field, wire = tag >> 3, tag & 7
        if field not in known:
            what = REFUSED.get(kind, {}).get(field, f"the unknown field {field}")
            raise Damaged(f"its {kind} has {what}")
        name = known[field]
        if wire not in ((VARINT, BYTES) if name == "dims" else (_wire_of(name),)):
            raise Damaged(f"its {kind} has a {name} of another type")
        if wire == VARINT:
            value, at = _varint(message, at)
            yield name, value
            continue
        size, at = (4, at) if wire == FIXED32 else _varint(message, at)
        if at + size > len(message):
            raise Damaged(f"its {kind} declares more data than the file has")
        yield name, message[at : at + size]
        at += size


def _wire_of(name: str) -> int:
    return VARINT if name in NUMBERS else FIXED32 if name == "f" else BYTES


def _bytes(value: int | memoryview) -> memoryview:
    """The value of a field that `_fields` has found to be bytes."""
    assert isinstance(value, memoryview)
    return value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number, and the position of the next field."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            break
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise Damaged("it ends within a number")


def _varints(message: memoryview) -> list[int]:
    values, at = [], 0
    while at < len(message):
        value, at = _varint(message, at)
        values.append(value)
    return values
