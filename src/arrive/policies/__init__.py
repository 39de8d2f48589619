"""Policies by name: exported ones that come with the package, and the run folders of a checkout's `policies/`.

Another exported one is a file beside this one and a line in `SHIPPED`.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from arrive.errors import ArriveError

if TYPE_CHECKING:
    from arrive.deployment.policy_file import PolicyFile

SHIPPED: dict[str, str] = {
    "joystick": "follows a stick, trained on all terrains (policies/joystick)",
}
"""Name and description of each shipped policy; its file is NAME.onnx."""
DEFAULT = "joystick"
"""The one that is run where none is named."""
EXPORTED = ".onnx"
TRAINED = Path(__file__).parents[3] / "policies"
"""Run folders of trained policies; an installed package has none."""


def shipped_file(name: str) -> Path:
    """The file of one of the policies in `SHIPPED`."""
    return Path(__file__).parent / f"{name}{EXPORTED}"


def trained_names() -> list[str]:
    """Names of the run folders in `TRAINED`."""
    return sorted(path.name for path in TRAINED.glob("*") if path.is_dir())


def find_run(path: Path) -> Path:
    """The path itself, or the folder in `TRAINED` of that name where nothing lies at the path."""
    return TRAINED / path if not path.exists() and str(path) in trained_names() else path


def open_policy(name: str | None = None) -> PolicyFile:
    """Read the policy that a person names on the command line.

    Args:
        name: of a shipped or trained policy, a run folder, a `policy.pt` or a file of `arrive export`; `DEFAULT` if
            there is none. What lies in a folder of the same name as a shipped policy is opened by ./NAME.

    Raises:
        ArriveError: it is none of these, or cannot be read.
    """
    # Imported here so that listing names needs no onnxruntime.
    from arrive.deployment.policy_file import read_policy_file

    name = name or DEFAULT
    path = find_run(Path(name))
    if name in SHIPPED:
        return read_policy_file(shipped_file(name))
    if path.is_file() and path.suffix == EXPORTED:
        return read_policy_file(path)
    if path.exists():
        return _exported(path)
    raise ArriveError(
        f"there is no policy {name!r}. Give a run folder, a policy.pt, an exported {EXPORTED} file, "
        f"or the name of a policy: {', '.join(sorted({*SHIPPED, *trained_names()}))}"
    )


def _exported(path: Path) -> PolicyFile:
    """Export a trained policy into a file that does not outlive the call."""
    # Imported here because only this needs torch.
    from arrive.deployment.export import export_policy
    from arrive.deployment.policy_file import read_policy_file
    from arrive.learning.policy import load_policy

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"policy{EXPORTED}"
        export_policy(load_policy(path), file)
        return read_policy_file(file)
