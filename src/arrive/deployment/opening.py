"""Opens the policy that a person names, exported or not."""

import tempfile
from pathlib import Path

from arrive.deployment.policy_file import PolicyFile, read_policy_file
from arrive.errors import ArriveError
from arrive.policies import DEFAULT, EXPORTED, SHIPPED, find_run, shipped_file, trained_names


def open_policy(name: str | None = None) -> PolicyFile:
    """Read the policy that a person names on the command line.

    Args:
        name: of a shipped or trained policy, a run folder, a `policy.pt` or a file of `arrive export`; `DEFAULT` if
            there is none. What lies in a folder of the same name as a shipped policy is opened by ./NAME.

    Raises:
        ArriveError: it is none of these, or cannot be read.
    """
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
    from arrive.learning.policy import load_policy

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"policy{EXPORTED}"
        export_policy(load_policy(path), file)
        return read_policy_file(file)
