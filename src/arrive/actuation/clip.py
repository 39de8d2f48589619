"""What a motor can give at most, as a limit on a torque that somebody else has computed."""

import math
from typing import Literal

import numpy as np

from arrive.actuation.motor import Motor

MotorClip = Literal["affine", "constant", "none"]


def limit_line(motor: Motor, clip: MotorClip) -> tuple[float, float, float]:
    """The limit in the positive direction: min(stall - slope * speed, effort).

    `affine` is the paper's line, stall_torque * (1 - w / no_load_speed), cut at the effort limit; beyond the no-load
    speed it brakes. `constant` is the effort limit alone, as legged_gym cuts the torque of its actuator network. `none`
    is no limit.

    Returns:
        stall [N m], slope [N m s/rad], effort [N m].
    """
    if clip == "affine":
        return motor.stall_torque, motor.stall_torque / motor.no_load_speed, motor.effort_limit
    effort = motor.effort_limit if clip == "constant" else math.inf
    return effort, 0.0, effort


def torque_limits(motor: Motor, clip: MotorClip, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest torque at a joint speed, by `limit_line`.

    Args:
        speed: joint velocity [rad/s], any shape.

    Returns:
        (lowest, highest) torque [N m], each of the shape of `speed`.
    """
    stall, slope, effort = limit_line(motor, clip)
    # Far beyond the no-load speed, where the lines would ask for more than the motor has, the effort limit decides.
    return np.clip(-stall - slope * speed, -effort, effort), np.clip(stall - slope * speed, -effort, effort)


def clip_torque(motor: Motor, clip: MotorClip, torque: np.ndarray, speed: np.ndarray) -> None:
    """Cut torques at what the motor can give at these speeds, in place.

    Args:
        torque: [N m], any shape.
        speed: joint velocity [rad/s], the same shape and type.
    """
    if clip != "none":
        np.clip(torque, *torque_limits(motor, clip, speed), out=torque)
