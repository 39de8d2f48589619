"""`arrive export` and `arrive verify`: a policy for a robot's computer."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from arrive.errors import ArriveError
from arrive.learning.policy import load_policy

if TYPE_CHECKING:
    from arrive.commands.options import Export, Verify


def export(command: Export) -> None:
    """Write a policy for a robot's computer."""
    need_onnxruntime()
    from arrive.deployment.export import export_policy

    policy = load_policy(command.policy)
    export_policy(policy, command.out)
    print(f"exported: {command.out} ({policy.config.robot}, {policy.config.task.name}, commit {policy.commit})")


def verify_file(command: Verify) -> None:
    """Check an exported policy and say what it is."""
    need_onnxruntime()
    from arrive.deployment.verify import describe, verify

    print(describe(verify(command.file)))


def need_onnxruntime() -> None:
    """Say how to install what runs exported policies, where it is missing."""
    if importlib.util.find_spec("onnxruntime") is None:
        raise ArriveError("this needs onnxruntime: pip install 'arrive[deploy]'")
