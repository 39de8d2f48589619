"""Policies by name: exported ones that come with the package, and the run folders of a checkout's `policies/`.

Another exported one is a file beside this one and a line in `SHIPPED`.
"""

from pathlib import Path

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
