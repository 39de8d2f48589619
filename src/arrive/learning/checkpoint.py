"""Checkpoints: written atomically, read without executing anything from the file."""

import os
import tempfile
from pathlib import Path
from typing import Any

import torch

from arrive.errors import ArriveError

FORMAT = 1
"""Version of the checkpoint's layout."""
CHECKPOINT_NAME = "checkpoint.pt"
POLICY_NAME = "policy.pt"


def save_atomically(content: dict[str, Any], path: Path) -> None:
    """Write a checkpoint so that a crash or a full disk at any moment leaves the previous one whole.

    Raises:
        ArriveError: the folder cannot be written or the disk is full.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                torch.save(content, file)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except (OSError, RuntimeError) as error:
        raise ArriveError(f"cannot write {path}: {error}. Free some space or choose another folder.") from error


def load_checked(path: Path) -> dict[str, Any]:
    """Read a checkpoint or policy file, tensors and plain data only.

    Raises:
        ArriveError: the file is missing, truncated, not one of ours, or of a newer format.
    """
    if not path.is_file():
        raise ArriveError(f"there is no file {path}")
    try:
        content = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # whatever damaged bytes make torch and its unpickler raise
        raise ArriveError(
            f"cannot read {path}: it is truncated, corrupt or not a checkpoint of arrive. "
            f"Use an earlier copy or train again. ({type(error).__name__})"
        ) from error
    if not isinstance(content, dict) or "format" not in content or "schema" not in content:
        raise ArriveError(f"{path} is not a checkpoint of arrive")
    if content["format"] != FORMAT:
        raise ArriveError(f"{path} has checkpoint format {content['format']}, this version reads {FORMAT}")
    return content


def check_schema(saved: list[dict[str, Any]], present: list[dict[str, Any]], path: Path) -> None:
    """Make sure a policy reads the observation it was trained on.

    Raises:
        ArriveError: the schemas differ; the message names the first term that does.
    """
    for ours, theirs in zip(present, saved, strict=False):
        if ours != theirs:
            keys = [key for key in ours if ours[key] != theirs.get(key)]
            raise ArriveError(
                f"{path} was trained on another observation: term {theirs.get('name')!r} there, {ours['name']!r} here, "
                f"differs in {', '.join(keys)}. Use the configuration and version it was trained with."
            )
    if len(saved) != len(present):
        raise ArriveError(
            f"{path} was trained on {len(saved)} observation terms, this configuration has {len(present)}"
        )
