"""Policies as every command takes them."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

from arrive.errors import ArriveError
from arrive.learning.policy import Policy, load_policy
from arrive.policies import EXPORTED, find_policy

if TYPE_CHECKING:
    import torch


def read_policy(path: Path | str, device: torch.device | str = "cpu") -> Policy:
    """Read the policy that a person names; see `find_policy`.

    Raises:
        ArriveError: there is none, or it cannot be read.
    """
    path = find_policy(path)
    if path.suffix != EXPORTED:
        return load_policy(path, device)
    need("onnxruntime")
    # Imported here because only this needs onnxruntime.
    from arrive.deployment.reading import load_exported

    return load_exported(path, device)


def need(package: str, requirement: str = "") -> None:
    """Say how to install what a command needs beside the package's own dependencies, where it is missing.

    Raises:
        ArriveError: it is missing.
    """
    if importlib.util.find_spec(package) is None:
        raise ArriveError(f"this needs {package}: pip install '{requirement or package}'")
