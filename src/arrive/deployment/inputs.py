"""The controller's inputs in one step, converted to one form so that they can be checked and logged."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from arrive.deployment.goals import Goal, Joystick, Target, WayPoints, to_number
from arrive.deployment.heights import GridHeights, HeightMap, HeightSampler, PointCloud
from arrive.rotation import heading

NOTHING = np.zeros(0)
"""Replaces an input that is not numeric. Its size is wrong for every input."""


@dataclass(frozen=True, eq=False)
class Sensors:
    """Measurements at one moment. The world frame must be level and fixed, with z up (such as odometry)."""

    joint_pos: Any
    """(joints,) in the order of the file's joint names [rad]."""
    joint_vel: Any
    """(joints,) [rad/s]."""
    base_pos_w: Any
    """(3,) origin of the base frame in the world [m]."""
    base_quat_w: Any
    """(4,) unit quaternion (w, x, y, z) that rotates from base to world."""
    base_lin_vel_b: Any
    """(3,) velocity of the base frame's origin, in the base frame [m/s]."""
    base_ang_vel_b: Any
    """(3,) in the base frame [rad/s]."""
    time_s: float
    """Time of the measurement on the clock of `now_s` [s]."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The inputs of one step as plain numbers. The sequence of frames fully determines the commands."""

    joint_pos: np.ndarray
    joint_vel: np.ndarray
    base_pos_w: np.ndarray
    base_quat_w: np.ndarray
    base_lin_vel_b: np.ndarray
    base_ang_vel_b: np.ndarray
    sensors_time_s: float
    heights_w: np.ndarray
    """(points,) float32 ground at the grid's points, NaN where nothing was seen [m]. Most of a log is this, and float32
    is finer than any sensor."""
    terrain_time_s: float
    now_s: float
    goal: Goal | None
    """None if the argument was not a goal."""
    mistake: str = ""
    """A fault of the arguments themselves, such as two that are swapped; empty if there is none."""


ARRAYS = ("joint_pos", "joint_vel", "base_pos_w", "base_quat_w", "base_lin_vel_b", "base_ang_vel_b", "heights_w")
TIMES = ("sensors_time_s", "terrain_time_s", "now_s")
GOALS = (Target, Joystick, WayPoints)
TERRAINS = (GridHeights, HeightMap, PointCloud)


def to_array(value: Any) -> np.ndarray:
    """A copy as float64, or an empty array if it is not made of real numbers. Masked entries become NaN."""
    try:
        if isinstance(value, np.ma.MaskedArray):
            value = np.ma.filled(value.astype(np.float64), np.nan)
        return NOTHING if np.iscomplexobj(value) else np.array(value, dtype=np.float64)
    except Exception:  # a control loop must outlive whatever a driver hands over
        return NOTHING


def frame_of(sensors: Any, goal: Any, terrain: Any, now_s: Any, grid: HeightSampler) -> Frame:
    """Convert the arguments of a step into a frame. This never raises because of the arguments."""
    values = {name: to_array(_attribute(sensors, name)) for name in ARRAYS[:-1]}
    heights, mistake = NOTHING, _swapped(sensors, goal, terrain)
    try:
        heights, wrong = _heights(terrain, values["base_pos_w"], values["base_quat_w"], grid)
        mistake = mistake or wrong
    except Exception as error:  # whatever properties and array types of a caller's own raise
        mistake = mistake or f"the {type(terrain).__name__} cannot be read: {type(error).__name__}"
    return Frame(
        **values,
        sensors_time_s=to_number(_attribute(sensors, "time_s")),
        heights_w=heights.astype(np.float32),
        terrain_time_s=to_number(_attribute(terrain, "time_s")),
        now_s=to_number(now_s),
        goal=_goal(goal),
        mistake=mistake,
    )


def _attribute(value: Any, name: str) -> Any:
    try:
        return getattr(value, name, None)
    except Exception:
        return None


def _goal(goal: Any) -> Goal | None:
    """The goal with plain numbers and its own class, even if a subclass was given."""
    for kind in GOALS:
        if issubclass(type(goal), kind):
            return kind(**{field.name: _attribute(goal, field.name) for field in fields(kind)})
    return None


def _swapped(sensors: Any, goal: Any, terrain: Any) -> str:
    """A message if an argument has the class of another one, otherwise an empty string."""
    roles = {"sensors": (Sensors,), "goal": GOALS, "terrain": TERRAINS}
    given = {"sensors": sensors, "goal": goal, "terrain": terrain}
    for name, value in given.items():
        for role, kinds in roles.items():
            if role != name and issubclass(type(value), kinds):
                return (
                    f"the argument {name} is a {type(value).__name__}, which belongs to {role}: "
                    "call step(sensors, goal, terrain, now_s)"
                )
    return ""


def _heights(terrain: Any, pos: np.ndarray, quat: np.ndarray, grid: HeightSampler) -> tuple[np.ndarray, str]:
    """Heights at the grid's points, and a message about faulty arguments."""
    kind = type(terrain)
    if issubclass(kind, GridHeights):
        heights = to_array(terrain.heights_w)
        return heights, _shapes("GridHeights(heights_w, time_s)", ("heights_w", heights, 1))
    posed = pos.shape == (3,) and quat.shape == (4,) and bool(np.isfinite(pos).all() and np.isfinite(quat).all())
    if issubclass(kind, HeightMap):
        origin, cell, heights = to_array(terrain.origin_w), to_number(terrain.resolution_m), to_array(terrain.heights_w)
        wanted = "HeightMap(origin_w, resolution_m, heights_w, time_s)"
        wrong = _shapes(wanted, ("origin_w", origin, (2,)), ("heights_w", heights, 2))
        if not wrong and not (0.0 < cell < np.inf and np.isfinite(origin).all()):
            wrong = f"{wanted}: origin_w must be finite and resolution_m above 0, not {cell:g}"
        if wrong or not posed or not heights.size:
            return NOTHING, wrong
        return grid.from_map(origin, cell, heights, pos, heading(quat)), ""
    if issubclass(kind, PointCloud):
        points = to_array(terrain.points_w)
        wrong = _shapes("PointCloud(points_w, time_s)", ("points_w", points, (None, 3)))
        return (NOTHING, wrong) if wrong or not posed else (grid.from_cloud(points, pos, heading(quat)), "")
    return NOTHING, ""


def _shapes(signature: str, *wanted: tuple[str, np.ndarray, int | tuple[int | None, ...]]) -> str:
    """A message about arrays with a wrong shape or number of dimensions. None in a shape means any size."""
    wrong = []
    for name, array, shape in wanted:
        if isinstance(shape, int):
            fits, text = array.ndim == shape, f"{shape} dimension{'s' * (shape > 1)}"
        else:
            fits = array.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
            text = f"({', '.join('n' if n is None else str(n) for n in shape)}{',' * (len(shape) == 1)})"
        if not fits:
            has = "no array of numbers" if array is NOTHING else f"of shape {array.shape}"
            wrong.append(f"{name} is {has}, not {text}")
    return f"{signature}: {'; '.join(wrong)}. Are arguments swapped?" if wrong else ""
