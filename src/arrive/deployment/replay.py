"""Recomputes the commands of a log."""

from arrive.deployment.command import JointCommand
from arrive.deployment.controller import Controller
from arrive.deployment.log import ControlLog
from arrive.errors import ArriveError


def replay(log: ControlLog, controller: Controller) -> list[JointCommand]:
    """Reset the controller and compute its commands for the logged inputs.

    Raises:
        ArriveError: the log was recorded with another policy.
    """
    if log.frames and log.policy_digest != controller.policy.digest:
        raise ArriveError(f"the log was recorded with another policy than {controller.policy.path}")
    controller.reset()
    return [controller.step_frame(frame) for frame in log.frames]
