"""`arrive export` and `arrive verify`: policy files for a robot's computer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arrive.commands.policies import need, read_policy
from arrive.files import whole
from arrive.policies import EXPORTED

if TYPE_CHECKING:
    from arrive.commands.options import Export, Verify


def export(command: Export) -> None:
    """Export a policy for a robot's computer."""
    need("onnxruntime")
    from arrive.deployment.export import export_policy

    policy = read_policy(command.policy)
    if policy.path.suffix == EXPORTED:
        with whole(command.out) as copy:
            copy.write_bytes(policy.path.read_bytes())
    else:
        export_policy(policy, command.out)
    print(f"exported: {command.out} ({policy.config.robot}, {policy.config.task.name}, commit {policy.commit})")


def verify_file(command: Verify) -> None:
    """Check an exported policy and print a description."""
    need("onnxruntime")
    from arrive.deployment.verify import file_summary, verify

    print(file_summary(verify(command.file)))
