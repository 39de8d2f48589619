"""What the controller refuses, and the limits that no command leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from arrive.deployment.inputs import Frame
    from arrive.deployment.policy_file import RobotSpec


class BadInput(Exception):
    """An input or result the policy must not act on; its message is the reason given with the safe stance."""


@dataclass(frozen=True)
class Safety:
    """When to give up on the policy and what to do then."""

    sensors_age_s: float = 0.1
    """Sensors older than this, or newer than now by as much, are stale: five control periods."""
    terrain_age_s: float = 1.0
    """The same for heights; ground does not move."""
    least_seen: float = 0.25
    """Heights need at least this share of points that were seen or have a seen neighbour."""
    recover_s: float = 0.5
    """The policy takes over again after inputs have been good for this long."""
    glide_rad_s: float = 0.5
    """Largest speed at which the safe stance moves joint targets to the default pose."""


DEFAULT = Safety()


def check_sensors(frame: Frame, safety: Safety, joints: int) -> None:
    """Make sure the robot's state is whole and fresh.

    Raises:
        BadInput: wrong size, non-finite, stale or not a rotation.
    """
    sizes = {
        "joint_pos": joints,
        "joint_vel": joints,
        "base_pos_w": 3,
        "base_quat_w": 4,
        "base_lin_vel_b": 3,
        "base_ang_vel_b": 3,
    }
    for name, size in sizes.items():
        value = getattr(frame, name)
        if value.shape != (size,):
            raise BadInput(f"{name} is not {size} numbers")
        if not np.isfinite(value).all():
            raise BadInput(f"{name} is not finite")
    if abs(float(frame.base_quat_w @ frame.base_quat_w) - 1.0) > 0.1:
        raise BadInput("base_quat_w is not a unit quaternion")
    _check_age("sensors", frame.sensors_time_s, frame.now_s, safety.sensors_age_s)


def check_terrain(frame: Frame, safety: Safety, points: int) -> None:
    """Make sure the heights are whole and fresh; NaN is a point that nothing was seen at.

    Raises:
        BadInput: wrong size, infinite or stale.
    """
    if frame.heights_w.shape != (points,):
        raise BadInput(f"heights are not {points} numbers, a height map or a point cloud")
    if np.isinf(frame.heights_w).any():
        raise BadInput("heights are infinite")
    _check_age("heights", frame.terrain_time_s, frame.now_s, safety.terrain_age_s)


def _check_age(what: str, time_s: float, now_s: float, limit_s: float) -> None:
    age = now_s - time_s
    if not abs(age) <= limit_s:
        raise BadInput(f"{what} are {age:.3g} s old, more than {limit_s:g} s from now")


class Limits:
    """The range in which joint targets stay."""

    def __init__(self, robot: RobotSpec):
        """Read joint limits and gains."""
        self._low, self._high = np.array(robot.joint_limits_rad).T
        self._effort = robot.effort_limit / robot.stiffness
        self._lag = robot.damping / robot.stiffness

    def within_joints(self, targets: np.ndarray) -> np.ndarray:
        """Targets cut to the joints' ranges."""
        return np.minimum(np.maximum(targets, self._low), self._high)

    def within_torque(self, targets: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """Targets cut so that |stiffness (target - q) - damping w| is within the effort limit, then to joint ranges.

        The range of the joints wins where the two exclude each other: a joint far outside it is pulled back, by as
        much as the drive itself allows.
        """
        centre = joint_pos + self._lag * joint_vel
        return self.within_joints(np.minimum(np.maximum(targets, centre - self._effort), centre + self._effort))
