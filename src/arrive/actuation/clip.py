"""What motors can give at most, as a limit on torques that somebody else has computed."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from arrive.actuation.motor import Motor

MotorClip = Literal["affine", "constant", "none"]


class TorqueClip:
    """The limits of motors side by side: min(stall - slope * speed, effort) in the positive direction, and its mirror
    image in the negative one.

    `affine` is the paper's line, stall_torque * (1 - w / no_load_speed), cut at the effort limit; beyond the no-load
    speed it brakes, as the back-EMF of a voltage-limited motor does. `constant` is the effort limit alone, as
    legged_gym cuts the torque of its actuator network. `none` is no limit.
    """

    def __init__(self, motors: Sequence[Motor], clip: MotorClip):
        """Lay the limits out along the last axis of torques and speeds; a single motor serves any number of joints."""
        self.clip = clip
        lines = np.array([_limit_line(motor, clip) for motor in motors]).T
        self.stall, self.slope, self.effort = lines if len(motors) > 1 else lines[:, 0]
        """(motors,) each, or numbers of a single motor [N m], [N m s/rad] and [N m]."""

    def limits(self, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest torque at joint speeds.

        Args:
            speed: (..., motors) joint velocity [rad/s].

        Returns:
            (lowest, highest) torque [N m], each of the shape and type of `speed`.
        """
        stall, slope, effort = (part.astype(speed.dtype, copy=False) for part in (self.stall, self.slope, self.effort))
        return affine_limits(stall, slope, effort, speed)

    def cut(self, torque: np.ndarray, speed: np.ndarray) -> None:
        """Clip torques to the motors' limits at these speeds, in place.

        Args:
            torque: (..., motors) [N m].
            speed: (..., motors) joint velocity [rad/s], the same type.
        """
        if self.clip != "none":
            np.clip(torque, *self.limits(speed), out=torque)


def _limit_line(motor: Motor, clip: MotorClip) -> tuple[float, float, float]:
    """Stall torque [N m], slope [N m s/rad] and effort limit [N m] of `TorqueClip`."""
    if clip == "affine":
        return motor.stall_torque, motor.stall_torque / motor.no_load_speed, motor.effort_limit
    effort = motor.effort_limit if clip == "constant" else math.inf
    return effort, 0.0, effort


def affine_limits(
    stall: np.ndarray | float, slope: np.ndarray | float, effort: np.ndarray | float, speed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest torque at a speed: the line stall - slope * speed and its mirror image, within the effort.

    Far beyond the no-load speed, where the lines would ask for more than the motor has, the effort limit decides.
    """
    return np.clip(-stall - slope * speed, -effort, effort), np.clip(stall - slope * speed, -effort, effort)


def motor_torque(
    motor: Motor, error_rad: np.ndarray, speed: np.ndarray, kind: Literal["dc", "ideal"] = "dc"
) -> np.ndarray:
    """Torque by the explicit formula, for tests of the simulated motor.

    Args:
        error_rad: joint target minus joint position [rad], any shape.
        speed: joint velocity [rad/s], the same shape.

    Returns:
        Torque [N m], the same shape.
    """
    torque = np.array(motor.asks(error_rad, speed))
    TorqueClip([motor], "affine" if kind == "dc" else "constant").cut(torque, speed)
    return torque
