"""Limits for plausible inputs, and limits for joint targets."""

import math
from dataclasses import dataclass, fields

import numpy as np

from arrive.deployment.specs import RobotSpec
from arrive.errors import ArriveError


@dataclass(frozen=True)
class Safety:
    """Limits beyond which the policy does not act, and settings of the safe stance."""

    sensors_age_s: float = 0.1
    """Sensor values older than this, or from the future by more than this, are stale. Five control periods [s]."""
    terrain_age_s: float = 1.0
    """The same for heights, which may be older because the ground does not move [s]."""
    gap_s: float = 0.5
    """Longest time between two steps. With more, the control loop is broken or its clock is not in seconds [s]."""
    least_seen: float = 0.25
    """Smallest share of height points that are seen or have a seen neighbour."""
    recover_s: float = 0.5
    """The policy takes over again after all inputs have been good for this long [s]."""
    glide_rad_s: float = 0.5
    """Largest speed at which the safe stance moves joint targets to the default pose [rad/s]."""
    still_steps: int = 5
    """If the clock hardly advances for this many steps, it stands still."""
    tilt_rad: float = 1.3
    """A base tilted by more than this has fallen. Policies on their hardest terrain tilt it by up to 1.13 rad [rad]."""
    joint_margin_rad: float = 1.0
    """Joint positions farther than this outside their range are implausible. In simulation, contacts push joints 0.3
    rad out of range [rad]."""
    joint_speed_share: float = 10.0
    """Joint speeds above this multiple of the highest no-load speed are implausible. In simulation, contacts drive
    joints to 8 times."""
    base_speed_m_s: float = 10.0
    """A base speed above this is implausible [m/s]."""
    base_rate_rad_s: float = 30.0
    """An angular velocity of the base above this is implausible [rad/s]."""
    jump: float = 0.2
    """Between two steps, positions may change by what the largest speed allows plus this [m or rad]."""
    ground_m: float = 3.0
    """If the base is this much higher or lower above the ground than when standing, base and heights are in different
    frames or units [m]."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ArriveError: a value that is not a finite number above 0.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
                raise ArriveError(f"Safety.{field.name} must be a finite number above 0, not {value!r}")


DEFAULT = Safety()


class Limits:
    """Clamps joint targets to joint ranges and torque limits."""

    def __init__(self, robot: RobotSpec):
        """Read joint limits and gains."""
        self._low, self._high = np.array(robot.joint_limits_rad).T
        stiffness = np.asarray(robot.stiffness)
        self._effort = np.asarray(robot.effort_limit) / stiffness
        self._lag = np.asarray(robot.damping) / stiffness

    def within_joints(self, targets: np.ndarray) -> np.ndarray:
        """Targets clamped to the joints' ranges."""
        return np.minimum(np.maximum(targets, self._low), self._high)

    def within_torque(self, targets: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """Targets clamped so that |stiffness (target - q) - damping w| <= effort limit, then to the joints' ranges.

        If both cannot hold, the joint range wins: a joint far outside its range is pulled back as hard as the drive
        itself allows.
        """
        centre = joint_pos + self._lag * joint_vel
        return self.within_joints(np.minimum(np.maximum(targets, centre - self._effort), centre + self._effort))
