"""Finds policies by name. Those that come with the package are run folders.

In a checkout they are in `policies/`. A wheel has only the files that it takes to run, measure and export them.
"""

import difflib
from pathlib import Path

from arrive.errors import ArriveError

DEFAULT = "joystick"
"""The policy that commands take if none is named."""
EXPORTED = ".onnx"
POLICY_NAME = "policy.pt"
"""File of the network in a run folder."""
CONFIG_NAME = "config.json"
"""Its configuration, beside it."""
DIFFICULTY_NAME = "difficulty.json"
"""What `arrive eval --protocol difficulty` found, beside it."""
CURVES_NAME = "curves.png"
"""The curves of its training, beside it."""
RUNS = Path("runs")
"""Where `arrive train` puts new runs."""
OWN_RESULTS = RUNS / "shipped"
"""Where the user's measurements of shipped policies are put."""
PACKED = Path(__file__).parent / "shipped"
"""Where an installed package has the shipped policies; see setup.py."""
SHIPPED = PACKED if PACKED.is_dir() else Path(__file__).parents[3] / "policies"


def shipped_names() -> list[str]:
    """Names of the shipped policies."""
    return _runs_in(SHIPPED)


def find_policy(name: Path | str) -> Path:
    """File or folder of a policy that the user names. All commands use this.

    Args:
        name: a run folder, a policy.pt, an exported file, or the name of a shipped policy. Files in the
            current folder come first.

    Raises:
        ArriveError: there is no such policy; the message suggests names.
    """
    path, shipped = Path(name), SHIPPED / name
    if path.is_file() or (path / POLICY_NAME).is_file():
        return path
    if str(name) in shipped_names():
        return shipped
    if path.exists():
        raise ArriveError(f"{path} is no policy: there is no file {path / POLICY_NAME}")
    raise ArriveError(f"there is no policy {str(name)!r}.{_meant(str(name))}")


def results_folder(path: Path) -> Path:
    """Folder of a policy's results: its run folder, or for an exported file a folder of the same name beside it.

    For shipped policies that were named by their name it is a folder of that name in `OWN_RESULTS`, because neither an
    installed package nor the tracked files of a checkout should change.
    """
    folder = path.with_suffix("") if path.suffix == EXPORTED else path.parent
    return OWN_RESULTS / folder.name if folder.parent == SHIPPED else folder


def _runs_in(folder: Path) -> list[str]:
    return sorted(path.parent.name for path in folder.glob(f"*/{POLICY_NAME}"))


def _meant(name: str) -> str:
    """Suggestions for an unknown name, and the known names."""
    known = {run: run for run in shipped_names()}
    for run in _runs_in(RUNS):
        known |= {run: str(RUNS / run), str(RUNS / run): str(RUNS / run)}
    close = difflib.get_close_matches(name, known, n=1)
    hint = f" Did you mean {known[close[0]]}?" if close else ""
    return (
        f"{hint} Give a run folder, a {POLICY_NAME}, a file of `arrive export`, "
        f"or a shipped policy: {', '.join(shipped_names())}"
    )
