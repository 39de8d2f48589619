"""Checks that the values of an exported policy are plausible: finite, and of the right sign, size and order."""

import math
from typing import Any

import numpy as np

from arrive.deployment.specs import MOTOR_FIGURES, GridSpec, RobotSpec, TaskSpec

LARGEST_ANGLE_RAD = 100.0
"""Joint limits beyond this are not in radians."""
LARGEST_LENGTH_M = 20.0
"""Largest length of a robot and of its height grid."""
MOST_SAMPLES = 10**15
"""Most policy steps of a training."""
LONGEST_TEXT = 200
"""Longest name, unit or label [characters]."""
SAME_M = 1e-4
"""Tolerance for the positions of grid points."""
SAME_AXIS = 1e-6
"""Tolerance for the squared length of a joint's axis."""
MOST_LINKS = 20
"""Most joints from the base to a foot."""
LEAST_GOLDEN = 1e-3
"""Golden inputs and outputs must vary by at least this. Constant pairs could be reproduced by any network."""


class Implausible(Exception):
    """An implausible value. The message names it."""


def text(name: str, value: Any, least: int = 1) -> str:
    """The value, if it is a text that can be printed in one line, of at least `least` characters."""
    if not isinstance(value, str) or not value.isprintable() or not least <= len(value.strip()) <= LONGEST_TEXT:
        raise Implausible(f"{name} is {value!r}, not a text of {least} to {LONGEST_TEXT} printable characters")
    return value


def texts(name: str, values: Any) -> list[str]:
    """The values, if they are a list of texts."""
    if not isinstance(values, list):
        raise Implausible(f"{name} is {values!r}, not a list of texts")
    return [text(f"{name}[{i}]", value) for i, value in enumerate(values)]


def number(name: str, value: Any) -> float:
    """The value, if it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise Implausible(f"{name} is {value!r}, not a finite number")
    return float(value)


def positive(name: str, value: Any, most: float = 1e6) -> float:
    """The value, if it is a number above 0 and at most `most`."""
    if not 0.0 < number(name, value) <= most:
        raise Implausible(f"{name} is {value!r}, not above 0 and at most {most:g}")
    return float(value)


def numbers(name: str, values: Any, size: int) -> list[float]:
    """The values, if they are a list of `size` finite numbers."""
    if not isinstance(values, list) or len(values) != size:
        raise Implausible(f"{name} is not a list of {size} numbers")
    return [number(f"{name}[{i}]", value) for i, value in enumerate(values)]


def length(name: str, value: Any) -> float:
    """The value, if it is a number that fits a robot's size [m]."""
    if abs(number(name, value)) > LARGEST_LENGTH_M:
        raise Implausible(f"{name} is {value!r}, farther than {LARGEST_LENGTH_M:g} m")
    return float(value)


def check_place(name: str, values: Any, size: int) -> None:
    """Check that the values are a list of `size` lengths."""
    for i, value in enumerate(numbers(name, values, size)):
        length(f"{name}[{i}]", value)


def ascending(name: str, values: Any) -> tuple[float, float]:
    """The values, if they are two numbers in ascending order."""
    low, high = numbers(name, values, 2)
    if not low < high:
        raise Implausible(f"{name} is {values!r}, not in ascending order")
    return low, high


def per_joint(name: str, value: Any, joints: int) -> list[float]:
    """One value per joint, from a single number for all or a list of `joints` numbers."""
    return numbers(name, value, joints) if isinstance(value, list) else [number(name, value)] * joints


def check_robot(robot: RobotSpec) -> None:
    """Check that limits, default pose, gains and motor values are plausible for a robot."""
    text("robot.name", robot.name)
    names = texts("robot.joint_names", robot.joint_names)
    if not names:
        raise Implausible("robot.joint_names is empty")
    if len(set(names)) != len(names):
        raise Implausible("robot.joint_names has a name twice")
    default = numbers("robot.default_joint_pos_rad", robot.default_joint_pos_rad, len(names))
    if not isinstance(robot.joint_limits_rad, list) or len(robot.joint_limits_rad) != len(names):
        raise Implausible(f"robot.joint_limits_rad is not a list of {len(names)} ranges")
    for joint, pose, limits in zip(names, default, robot.joint_limits_rad, strict=True):
        low, high = ascending(f"the range of {joint}", limits)
        if max(-low, high) > LARGEST_ANGLE_RAD:
            raise Implausible(f"the range of {joint} is {limits}, which is not in radians")
        if not low <= pose <= high:
            raise Implausible(f"the default position of {joint}, {pose:g} rad, is outside its range {limits}")
    positive("robot.action_scale_rad", robot.action_scale_rad, LARGEST_ANGLE_RAD)
    positive("robot.standing_height_m", robot.standing_height_m, LARGEST_LENGTH_M)
    figures = {name: per_joint(f"robot.{name}", getattr(robot, name), len(names)) for name in MOTOR_FIGURES}
    for name, values in figures.items():
        for value in values:
            if name == "damping" and value < 0.0:
                raise Implausible(f"robot.damping is {robot.damping!r}, not 0 or above")
            if name != "damping":
                positive(f"robot.{name}", value)
    if any(map(float.__lt__, figures["stall_torque"], figures["effort_limit"])):
        raise Implausible("robot.stall_torque is below robot.effort_limit")


def check_grid(grid: GridSpec) -> None:
    """Check that the points are a complete regular grid, x slowest, both ascending."""
    step = positive("heights.step_m", grid.step_m, LARGEST_LENGTH_M)
    low, high = ascending("heights.clip_m", grid.clip_m)
    if not -LARGEST_LENGTH_M <= low < 0.0 < high <= LARGEST_LENGTH_M:
        raise Implausible(f"heights.clip_m is {grid.clip_m!r}, not a depth above and one below")
    length("heights.offset_m", grid.offset_m)
    if not isinstance(grid.points_m, list) or not grid.points_m:
        raise Implausible("heights.points_m is not a list of points")
    points = np.array([numbers(f"heights.points_m[{i}]", point, 2) for i, point in enumerate(grid.points_m)])
    low, high = points.min(axis=0), points.max(axis=0)
    if max(-low.min(), high.max()) > LARGEST_LENGTH_M:
        raise Implausible("heights.points_m are too far away")
    nx, ny = grid.shape
    if nx * ny != len(points) or not _is_grid(points, low, step, nx, ny):
        raise Implausible("heights.points_m are not a complete grid with a spacing of heights.step_m")
    samples = grid.samples
    if isinstance(samples, bool) or not isinstance(samples, int) or samples < 1 or nx % samples or ny % samples:
        raise Implausible(f"heights.samples is {samples!r}, which does not divide a grid of {nx} x {ny} points")


def _is_grid(points: np.ndarray, low: np.ndarray, step: float, nx: int, ny: int) -> bool:
    """Whether these are nx x ny points from `low` on, x slowest."""
    whole = low + step * np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), axis=-1).reshape(-1, 2)
    return bool(np.abs(points - whole).max() <= SAME_M)


def check_feet(robot: RobotSpec, grid: GridSpec) -> None:
    """Check that the chains from the base to the feet are made of the robot's joints, places and axes."""
    if bool(robot.feet) != bool(grid.foot_points_m):
        raise Implausible("robot.feet and heights.foot_points_m must both be given or both be absent")
    for i, place in enumerate(grid.foot_points_m):
        check_place(f"heights.foot_points_m[{i}]", place, 2)
    for i, chain in enumerate(robot.feet):
        name = f"robot.feet[{i}]"
        check_place(f"{name}.foot_m", chain.foot_m, 3)
        joints = [link.joint for link in chain.links]
        if (
            not 0 < len(joints) <= MOST_LINKS
            or len(set(joints)) != len(joints)
            or not {*joints} <= {*robot.joint_names}
        ):
            raise Implausible(f"{name} has the joints {joints}, not 1 to {MOST_LINKS} different ones of the robot")
        for link in chain.links:
            where = f"{name}, {link.joint}:"
            check_place(f"{where} pos_m", link.pos_m, 3)
            axis = np.array(numbers(f"{where} axis", link.axis, 3))
            if abs(axis @ axis - 1.0) > SAME_AXIS:
                raise Implausible(f"{where} axis is {link.axis}, not of length 1")


def check_task(task: TaskSpec) -> None:
    """Check that times and distances are plausible for a task."""
    text("task.name", task.name)
    positive("task.episode_s", task.episode_s)
    positive("task.reward_window_s", task.reward_window_s, task.episode_s)
    positive("task.arrival_radius_m", task.arrival_radius_m)
    length("task.target_height_m", task.target_height_m)
    near, far = numbers("task.target_distance_m", task.target_distance_m, 2)
    if not 0.0 <= near <= far or far == 0.0:
        raise Implausible(f"task.target_distance_m is {task.target_distance_m!r}, not a range of distances")


def check_golden(golden: dict[str, Any], size: int, joints: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, size) inputs and (n, joints) outputs of the golden pairs, if they can detect a broken network."""
    pairs = []
    for name, width in (("observations", size), ("actions", joints)):
        values = np.array(golden[name])
        if values.dtype.kind not in "fi":
            raise Implausible(f"golden.{name} are not all numbers")
        values = values.astype(np.float32)
        if values.ndim != 2 or values.shape[1] != width or len(values) < 2:
            raise Implausible(f"golden.{name} are not at least two rows of {width} numbers")
        if not np.isfinite(values).all():
            raise Implausible(f"golden.{name} are not finite")
        if not np.ptp(values, axis=0).max() >= LEAST_GOLDEN:
            raise Implausible(f"golden.{name} are all the same")
        pairs.append(values)
    if len(pairs[0]) != len(pairs[1]):
        raise Implausible("golden.observations and golden.actions differ in number")
    return pairs[0], pairs[1]


def check_training(training: Any, evaluation: Any) -> None:
    """Check what is known about a policy's training, except for its configuration, which only `arrive` can read."""
    if not isinstance(training, dict) or not isinstance(training.get("config"), dict):
        raise Implausible("training has no configuration")
    text("training.commit", training.get("commit"))
    samples = training.get("samples")
    if type(samples) is not int or not 0 <= samples <= MOST_SAMPLES:
        raise Implausible(f"training.samples is {samples!r}, not a number of policy steps")
    if evaluation is not None and not isinstance(evaluation, dict):
        raise Implausible(f"evaluation is {evaluation!r}, not a result or null")
