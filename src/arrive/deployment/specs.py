"""The robot, observation and task that an exported policy describes."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from arrive.kinematics import FootChain, FootKinematics

PerJoint = float | list[float]
"""One number for all joints, or a list in the order of `joint_names`."""
MOTOR_FIGURES = ("stiffness", "damping", "effort_limit", "stall_torque", "no_load_speed")
"""Fields of `RobotSpec` that are `PerJoint`."""


@dataclass(frozen=True)
class Term:
    """One named slice of the observation."""

    name: str
    start: int
    stop: int
    unit: str
    frame: str
    scale: float
    """The network gets value * scale."""
    labels: list[str]


@dataclass(frozen=True)
class RobotSpec:
    """The robot's properties that the controller needs. Lists are in the order of `joint_names`."""

    name: str
    joint_names: list[str]
    default_joint_pos_rad: list[float]
    joint_limits_rad: list[list[float]]
    """Lowest and highest position of each joint."""
    action_scale_rad: float
    """Joint target = default position + action scale * action."""
    stiffness: PerJoint
    """Proportional gain of the drives [N m/rad]."""
    damping: PerJoint
    """Derivative gain of the drives [N m s/rad]."""
    effort_limit: PerJoint
    """[N m]."""
    stall_torque: PerJoint
    """[N m]."""
    no_load_speed: PerJoint
    """[rad/s]."""
    standing_height_m: float
    """Height of the base above flat ground in the default pose."""
    feet: tuple[FootChain, ...] = ()
    """From the base to each foot; empty if the policy does not observe the ground around its feet."""

    @cached_property
    def kinematics(self) -> FootKinematics:
        """Computes the feet's positions."""
        return FootKinematics(self.feet, self.joint_names)


@dataclass(frozen=True)
class GridSpec:
    """The grid of points at which the controller needs the ground height, and what the network receives of it."""

    points_m: list[list[float]]
    """x forward and y left of the base, in the heading frame."""
    step_m: float
    """Distance between points."""
    offset_m: float
    """Heights are relative to a point this far below the base, positive down."""
    clip_m: list[float]
    """Range to which relative heights are clipped."""
    samples: int = 1
    """The network receives the mean of each square of this many points per side, after clipping."""
    foot_points_m: list[list[float]] = field(default_factory=list)
    """The network also receives the height of the grid's points nearest to these places around each foot, given from
    the foot in the heading frame."""

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Number of points along x and y."""
        points = np.array(self.points_m)
        rows, columns = np.rint((points.max(axis=0) - points.min(axis=0)) / self.step_m).astype(int) + 1
        return int(rows), int(columns)

    def nearest(self, places: np.ndarray) -> np.ndarray:
        """(k,) index of the point nearest to each of (k, 2) places in the heading frame [m]."""
        cells = np.rint((places - self.points_m[0]) / self.step_m)
        row, column = np.clip(cells, 0, np.array(self.shape) - 1).astype(int).T
        return row * self.shape[1] + column

    @property
    def num_heights(self) -> int:
        """Number of heights that the network receives."""
        return len(self.points_m) // self.samples**2


@dataclass(frozen=True)
class TaskSpec:
    """The task that the policy was trained on."""

    name: str
    reward_window_s: float
    episode_s: float
    target_height_m: float
    """Height of targets above the ground."""
    target_distance_m: list[float]
    """Smallest and largest distance of targets."""
    arrival_radius_m: float
