"""The limits of what the controller believes, and the limits that no command leaves."""

import math
from dataclasses import dataclass, fields

import numpy as np

from arrive.deployment.specs import RobotSpec
from arrive.errors import ArriveError


@dataclass(frozen=True)
class Safety:
    """When to give up on the policy and what to do then."""

    sensors_age_s: float = 0.1
    """Sensors older than this, or newer than now by as much, are stale: five control periods [s]."""
    terrain_age_s: float = 1.0
    """The same for heights; ground does not move [s]."""
    gap_s: float = 0.5
    """Steps farther apart than this are no control loop, or their clock does not count seconds [s]."""
    least_seen: float = 0.25
    """Heights need at least this share of points that were seen or have a seen neighbour."""
    recover_s: float = 0.5
    """The policy takes over again after inputs have been good for this long [s]."""
    glide_rad_s: float = 0.5
    """Largest speed at which the safe stance moves joint targets to the default pose [rad/s]."""
    still_steps: int = 5
    """A clock that hardly moves for this many steps stands still."""
    tilt_rad: float = 1.3
    """A base tilted by more than this has fallen. Policies on their hardest terrain walk with up to 1.13 rad [rad]."""
    joint_margin_rad: float = 1.0
    """Joints this far outside their range cannot be; contacts push simulated ones out by 0.3 rad [rad]."""
    joint_speed_share: float = 10.0
    """Joints cannot be faster than this many times the highest no-load speed; contacts drive simulated ones to 8
    times."""
    base_speed_m_s: float = 10.0
    """A base cannot be faster than this [m/s]."""
    base_rate_rad_s: float = 30.0
    """A base cannot turn faster than this [rad/s]."""
    jump: float = 0.2
    """Between two steps, positions change by no more than the largest speed allows and this [m or rad]."""
    ground_m: float = 3.0
    """A base that is this much higher or lower over the ground than when it stands is in another frame than the
    heights, or in another unit [m]."""

    def __post_init__(self):
        """Refuse what is no limit.

        Raises:
            ArriveError: a value that is not a finite number above 0.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
                raise ArriveError(f"Safety.{field.name} must be a finite number above 0, not {value!r}")


DEFAULT = Safety()


class Limits:
    """The range in which joint targets stay."""

    def __init__(self, robot: RobotSpec):
        """Read joint limits and gains."""
        self._low, self._high = np.array(robot.joint_limits_rad).T
        stiffness = np.asarray(robot.stiffness)
        self._effort = np.asarray(robot.effort_limit) / stiffness
        self._lag = np.asarray(robot.damping) / stiffness

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
