"""Exported policies that come with the package; another is a file beside this one and a line in `SHIPPED`."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from arrive.errors import ArriveError

if TYPE_CHECKING:
    from arrive.deployment.policy_file import PolicyFile

SHIPPED: dict[str, str] = {
    "flat": "trained on flat ground alone (results/flat-shipped)",
}
"""Name and description of each shipped policy; its file is NAME.onnx."""
DEFAULT = "flat"
"""The one that is run where none is named."""
EXPORTED = ".onnx"


def shipped_file(name: str) -> Path:
    """The file of one of the policies in `SHIPPED`."""
    return Path(__file__).parent / f"{name}{EXPORTED}"


def open_policy(name: str | None = None) -> PolicyFile:
    """Read the policy that a person names on the command line.

    Args:
        name: of a shipped policy, a run folder, a `policy.pt` or a file of `arrive export`; `DEFAULT` if there is none.
            What lies in a folder of the same name as a shipped policy is opened by ./NAME.

    Raises:
        ArriveError: it is none of these, or cannot be read.
    """
    # Imported here so that listing names needs no onnxruntime.
    from arrive.deployment.policy_file import read_policy_file

    name = name or DEFAULT
    path = Path(name)
    if name in SHIPPED:
        return read_policy_file(shipped_file(name))
    if path.is_file() and path.suffix == EXPORTED:
        return read_policy_file(path)
    if path.exists():
        return _exported(path)
    raise ArriveError(
        f"there is no policy {name!r}. Give a run folder, a policy.pt, an exported {EXPORTED} file, "
        f"or the name of a shipped policy: {', '.join(sorted(SHIPPED))}"
    )


def _exported(path: Path) -> PolicyFile:
    """Export a trained policy into a file that does not outlive the call."""
    # Imported here because only this needs torch.
    from arrive.deployment.export import export_policy
    from arrive.deployment.policy_file import read_policy_file
    from arrive.evaluation.policy import load_policy

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"policy{EXPORTED}"
        export_policy(load_policy(path), file)
        return read_policy_file(file)
