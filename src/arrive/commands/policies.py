"""Reading the policies named on the command line."""

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
    """Read the policy that the user names; see `find_policy`.

    Raises:
        ArriveError: there is no such policy, or it cannot be read.
    """
    path = find_policy(path)
    if path.suffix != EXPORTED:
        return load_policy(path, device)
    need("onnxruntime")
    # Imported here because only exported files need onnxruntime.
    from arrive.deployment.reading import load_exported

    return load_exported(path, device)


def need(package: str, requirement: str = "") -> None:
    """Check that an optional dependency of a command is installed.

    Raises:
        ArriveError: it is missing; the message says how to install it.
    """
    if importlib.util.find_spec(package) is None:
        raise ArriveError(f"this needs {package}: pip install '{requirement or package}'")
