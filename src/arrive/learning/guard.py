"""Stops training on NaN or infinity, names the term and the environments, and saves a dump."""

import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from arrive.learning.checkpoint import save_sealed

MAX_LISTED = 10


class NonFiniteError(Exception):
    """An observation, a reward, a loss or a network is not finite."""

    def __init__(self, what: str, tensors: dict[str, Tensor]):
        super().__init__(what)
        self.tensors = tensors


def check_terms(kind: str, terms: dict[str, Tensor]) -> None:
    """Check that per-environment values are finite.

    Args:
        terms: (num_envs, ...) values by name.

    Raises:
        NonFiniteError: names the terms and the environments.
    """
    bad = {name: ~value.reshape(len(value), -1).isfinite().all(-1) for name, value in terms.items()}
    bad = {name: mask for name, mask in bad.items() if bool(mask.any())}
    if bad:
        parts = [f"{name} in environments {_listed(mask)}" for name, mask in bad.items()]
        raise NonFiniteError(f"non-finite {kind}: {'; '.join(parts)}", {name: terms[name] for name in bad})


def check_losses(losses: dict[str, float], parameters: dict[str, Tensor]) -> None:
    """Check that losses and networks are finite after an update.

    Raises:
        NonFiniteError: names the losses and parameters.
    """
    names = [f"loss {name}" for name, value in losses.items() if not math.isfinite(value)]
    broken = {name: value for name, value in parameters.items() if not bool(value.isfinite().all())}
    if names or broken:
        raise NonFiniteError(f"non-finite after the update: {', '.join([*names, *broken])}", broken)


def save_dump(folder: Path, iteration: int, error: NonFiniteError, state: dict[str, Any]) -> Path:
    """Save the non-finite values and the last good state for debugging."""
    path = folder / f"dump_{iteration}.pt"
    save_sealed({"what": str(error), "values": error.tensors, "state": state}, path)
    return path


def _listed(mask: Tensor) -> str:
    ids = mask.nonzero().squeeze(-1).tolist()
    more = f" and {len(ids) - MAX_LISTED} more" if len(ids) > MAX_LISTED else ""
    return ", ".join(map(str, ids[:MAX_LISTED])) + more


def all_finite(*tensors: Tensor) -> bool:
    """Whether all values are finite. Tests only the sum of each tensor, which is cheap."""
    return all(bool(torch.isfinite(tensor.sum())) for tensor in tensors)
