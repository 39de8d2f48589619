"""Checks an exported policy: `python -m arrive.deployment.verify FILE`. Needs only NumPy and onnxruntime.

With the training installation, robot, observation, height grid, control period and task are also compared with those of
this version of `arrive`.
"""

import importlib.util
import sys
from pathlib import Path

from arrive.deployment.policy_file import PolicyFile, read_policy_file
from arrive.errors import ArriveError

TRAINING = ("torch", "mujoco", "rsl_rl", "onnx")
"""Packages that the comparison with this version's robot and task needs."""


def has_training() -> bool:
    """Whether this is the training installation."""
    return all(importlib.util.find_spec(name) is not None for name in TRAINING)


def verify(path: Path | str) -> PolicyFile:
    """Run all checks of an exported policy.

    Raises:
        ArriveError: see `read_policy_file`; or its robot, observation, height grid, control period or task differs
            from that of this version of arrive.
    """
    file = read_policy_file(path)
    if has_training():
        # Imported here because the controller's installation has none of what this needs.
        from arrive.deployment.export import compare_with_this_version

        compare_with_this_version(file)
    return file


def file_summary(file: PolicyFile) -> str:
    """One line about a valid file."""
    compared = "" if has_training() else "; its robot and task were not compared, which needs the training installation"
    return (
        f"{file.path} is sound: {file.robot.name}, {len(file.robot.joint_names)} joints, {file.terms[-1].stop} "
        f"observations, task {file.task.name}, {1.0 / file.period_s:.0f} Hz, {len(file.meta['golden']['actions'])} "
        f"golden pairs reproduced{compared}"
    )


def main(arguments: list[str] | None = None) -> None:
    """Check the file named on the command line. An error prints one line on standard error and exits with 1."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if len(arguments) != 1 or arguments[0].startswith("-"):
        print("usage: arrive verify FILE", file=sys.stderr)
        sys.exit(2)
    try:
        print(file_summary(verify(arguments[0])))
    except ArriveError as error:
        print(f"arrive: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
