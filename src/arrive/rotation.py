"""Rotations of single bodies in NumPy; quaternions are (w, x, y, z). `task/rotation.py` has those of all robots."""

import math

import numpy as np


def matrix(quat: np.ndarray) -> np.ndarray:
    """(3, 3) rotation matrix from the body's frame to the world's of a unit quaternion."""
    w, x, y, z = quat.tolist()
    return np.array([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ])  # fmt: skip


def heading(quat: np.ndarray) -> float:
    """Angle of the base's x axis in the horizontal plane, from the world's x axis [rad]."""
    w, x, y, z = quat.tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def tilt(quat: np.ndarray) -> float:
    """Angle between the base's z axis and the vertical, 0 to pi; the quaternion may be of any length [rad]."""
    w, x, y, z = quat.tolist()
    return 2.0 * math.atan2(math.hypot(x, y), math.hypot(w, z))


def angle_between(first: np.ndarray, second: np.ndarray) -> float:
    """Angle of the rotation from one orientation to another, 0 to pi; the quaternions may be of any length [rad]."""
    lengths = math.sqrt(float(first @ first) * float(second @ second))
    return 2.0 * math.acos(min(abs(float(first @ second)) / lengths, 1.0))
