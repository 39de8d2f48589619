"""What an exported policy says of its robot, its observation and its task."""

from dataclasses import dataclass

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
    """The network receives value * scale."""
    labels: list[str]


@dataclass(frozen=True)
class RobotSpec:
    """What the controller must know of the robot; lists are in the order of `joint_names`."""

    name: str
    joint_names: list[str]
    default_joint_pos_rad: list[float]
    joint_limits_rad: list[list[float]]
    """Lowest and highest position of each joint."""
    action_scale_rad: float
    """Joint target = default position + this * action."""
    stiffness: PerJoint
    """Proportional gain the drives must run with [N m/rad]."""
    damping: PerJoint
    """Derivative gain the drives must run with [N m s/rad]."""
    effort_limit: PerJoint
    """[N m]."""
    stall_torque: PerJoint
    """[N m]."""
    no_load_speed: PerJoint
    """[rad/s]."""
    standing_height_m: float
    """Base above flat ground at the default pose."""


@dataclass(frozen=True)
class GridSpec:
    """Where the network wants to know the ground's height."""

    points_m: list[list[float]]
    """x forward and y left of the base, horizontal, turned with its heading."""
    step_m: float
    offset_m: float
    """Heights are relative to this far below the base, positive down."""
    clip_m: list[float]
    """Least and largest relative height: beyond them they are cut."""


@dataclass(frozen=True)
class TaskSpec:
    """What the policy was trained to do."""

    name: str
    reward_window_s: float
    episode_s: float
    target_height_m: float
    """Targets were this high above the ground."""
    target_distance_m: list[float]
    """Nearest and farthest target."""
    arrival_radius_m: float
