"""Opens the policy that the user names, exported or not."""

import tempfile
from pathlib import Path

from arrive.deployment.policy_file import PolicyFile, read_policy_file
from arrive.policies import DEFAULT, EXPORTED, find_policy


def open_policy(name: Path | str | None = None) -> PolicyFile:
    """Open a policy for the controller; see `find_policy` for names. Without a name, open `DEFAULT`.

    Raises:
        ArriveError: there is no policy of this name, or it cannot be read.
    """
    path = find_policy(name or DEFAULT)
    return read_policy_file(path) if path.suffix == EXPORTED else _exported(path)


def _exported(path: Path) -> PolicyFile:
    """Export a trained policy into a temporary file and read that."""
    # Imported here because only this needs torch.
    from arrive.deployment.export import export_policy
    from arrive.learning.policy import load_policy

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"policy{EXPORTED}"
        export_policy(load_policy(path), file)
        return read_policy_file(file)
