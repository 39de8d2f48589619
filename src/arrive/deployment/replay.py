"""Computes the commands of a logged drive again."""

from arrive.deployment.command import JointCommand
from arrive.deployment.controller import Controller
from arrive.deployment.log import ControlLog
from arrive.errors import ArriveError


def replay(log: ControlLog, controller: Controller) -> list[JointCommand]:
    """The commands that the controller gives from a fresh start to the logged inputs.

    Raises:
        ArriveError: the log is of another policy.
    """
    if log.frames and log.policy_digest != controller.policy.digest:
        raise ArriveError(f"the log was taken with another policy than {controller.policy.path}")
    controller.reset()
    return [controller.step_frame(frame) for frame in log.frames]
