"""What the controller is told in one step, brought into one shape whatever arrives, so that it can be logged."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from arrive.deployment.goals import Goal, Joystick, Target, WayPoints, number
from arrive.deployment.heights import GridHeights, HeightGrid, HeightMap, PointCloud
from arrive.deployment.rotation import heading

NOTHING = np.zeros(0)
"""Stands for an input that is not made of numbers; its size is wrong everywhere."""


@dataclass(frozen=True, eq=False)
class Sensors:
    """Measurements of one moment. The world frame is any that is level, keeps still and has z up (odometry)."""

    joint_pos: Any
    """(joints,) in the order of the file's joint names [rad]."""
    joint_vel: Any
    """(joints,) [rad/s]."""
    base_pos_w: Any
    """(3,) origin of the base frame in the world [m]."""
    base_quat_w: Any
    """(4,) unit quaternion (w, x, y, z) that rotates base into world."""
    base_lin_vel_b: Any
    """(3,) velocity of the base frame's origin, in the base frame [m/s]."""
    base_ang_vel_b: Any
    """(3,) in the base frame [rad/s]."""
    time_s: float
    """When they were measured, on the clock of `now_s` [s]."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The inputs of one step as plain numbers; the commands follow from the sequence of these alone."""

    joint_pos: np.ndarray
    joint_vel: np.ndarray
    base_pos_w: np.ndarray
    base_quat_w: np.ndarray
    base_lin_vel_b: np.ndarray
    base_ang_vel_b: np.ndarray
    sensors_time_s: float
    heights_w: np.ndarray
    """(points,) ground at the grid's points, NaN where nothing was seen [m]."""
    terrain_time_s: float
    now_s: float
    goal: Goal | None
    """None where what was given is no goal."""


ARRAYS = ("joint_pos", "joint_vel", "base_pos_w", "base_quat_w", "base_lin_vel_b", "base_ang_vel_b", "heights_w")
TIMES = ("sensors_time_s", "terrain_time_s", "now_s")


def numbers(value: Any) -> np.ndarray:
    """A copy as float64, or an empty array where it is not made of numbers."""
    try:
        return np.array(value, dtype=np.float64)
    except Exception:  # a control loop must outlive whatever a driver hands over
        return NOTHING


def frame_of(sensors: Any, goal: Any, terrain: Any, now_s: Any, grid: HeightGrid) -> Frame:
    """Bring the arguments of a step into a frame; nothing they can hold makes this raise."""
    values = {name: numbers(getattr(sensors, name, None)) for name in ARRAYS[:-1]}
    return Frame(
        **values,
        sensors_time_s=number(getattr(sensors, "time_s", None)),
        heights_w=_heights(terrain, values["base_pos_w"], values["base_quat_w"], grid),
        terrain_time_s=number(getattr(terrain, "time_s", None)),
        now_s=number(now_s),
        goal=goal if isinstance(goal, Target | Joystick | WayPoints) else None,
    )


def _heights(terrain: Any, pos: np.ndarray, quat: np.ndarray, grid: HeightGrid) -> np.ndarray:
    if isinstance(terrain, GridHeights):
        return numbers(terrain.heights_w)
    posed = pos.shape == (3,) and quat.shape == (4,) and bool(np.isfinite(pos).all() and np.isfinite(quat).all())
    if not posed:
        return NOTHING
    if isinstance(terrain, HeightMap):
        origin, heights = numbers(terrain.origin_w), numbers(terrain.heights_w)
        cell = number(terrain.resolution_m)
        if origin.shape == (2,) and np.isfinite(origin).all() and 0.0 < cell < np.inf and heights.ndim == 2:
            return grid.from_map(origin, cell, heights, pos, heading(quat)) if heights.size else NOTHING
    if isinstance(terrain, PointCloud):
        points = numbers(terrain.points_w)
        if points.ndim == 2 and points.shape[1] == 3:
            return grid.from_cloud(points, pos, heading(quat))
    return NOTHING
