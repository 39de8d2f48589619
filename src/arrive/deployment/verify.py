"""Checks an exported policy: `python -m arrive.deployment.verify FILE`. Needs NumPy and onnxruntime alone.

Where the training installation is at hand, robot, observation, height grid, control period and task are compared with
what this version of `arrive` has under these names.
"""

import importlib.util
import sys
from pathlib import Path

from arrive.deployment.policy_file import PolicyFile, read_policy_file
from arrive.errors import ArriveError

TRAINING = ("torch", "mujoco", "rsl_rl", "onnx")
"""What the comparison with this version's robot and task needs."""


def has_training() -> bool:
    """Whether this is the training installation."""
    return all(importlib.util.find_spec(name) is not None for name in TRAINING)


def verify(path: Path | str) -> PolicyFile:
    """Recompute all that can be recomputed of an exported policy.

    Raises:
        ArriveError: see `read_policy_file`; or its robot, observation, height grid, control period or task is not what
            this version of arrive has under these names.
    """
    file = read_policy_file(path)
    if has_training():
        # Imported here because the controller's installation has none of what this needs.
        from arrive.deployment.export import compare_with_this_version

        compare_with_this_version(file)
    return file


def describe(file: PolicyFile) -> str:
    """One line about a sound file."""
    compared = "" if has_training() else "; its robot and task were not compared, which the training installation does"
    return (
        f"{file.path} is sound: {file.robot.name}, {len(file.robot.joint_names)} joints, {file.terms[-1].stop} "
        f"observations, task {file.task.name}, {1.0 / file.period_s:.0f} Hz, {len(file.meta['golden']['actions'])} "
        f"golden pairs met{compared}"
    )


def main(arguments: list[str] | None = None) -> None:
    """Check the file named on the command line; a problem is one line on standard error and exit status 1."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if len(arguments) != 1 or arguments[0].startswith("-"):
        print("usage: arrive verify FILE", file=sys.stderr)
        sys.exit(2)
    try:
        print(describe(verify(arguments[0])))
    except ArriveError as error:
        print(f"arrive: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
