"""Checks an exported policy against the robot, the task and the golden pairs it names."""

from pathlib import Path
from typing import Any

import onnx

from arrive.config import Config, from_dict
from arrive.deployment.export import describe, weights_digest
from arrive.deployment.policy_file import PolicyFile, read_policy_file
from arrive.errors import ArriveError


def verify(path: Path) -> PolicyFile:
    """Recompute all that can be recomputed of an exported policy.

    Raises:
        ArriveError: the file is damaged or foreign, its network is not the exported one, or its robot, observation,
            height grid, control period or task is not what this version of arrive has under these names.
    """
    file = read_policy_file(path)
    if weights_digest(onnx.load(path)) != file.meta["weights"]["sha256"]:
        raise ArriveError(f"the network in {path} was changed after the export. Export the policy again.")
    try:
        config = from_dict(Config, file.meta["training"]["config"])
    except (KeyError, TypeError, AttributeError) as error:
        raise ArriveError(f"the metadata of {path} is damaged: {error!r}. Export the policy again.") from error
    for section, expected in describe(config).items():
        _compare(path, section, file.meta[section], expected)
    return file


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
