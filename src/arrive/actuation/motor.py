"""PD tracking of a joint target by a motor whose torque falls with speed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import mujoco
import numpy as np

MotorKind = Literal["dc", "ideal", "network"]


@dataclass(frozen=True)
class Motor:
    """A geared joint drive under PD control (paper, section on hardware deployment).

    The torque asked for is stiffness * (target - q) - damping * w. The drive can give at most
    min(effort_limit, stall_torque * (1 - w / no_load_speed)) in the positive direction, and the mirror image of it
    in the negative one: an affine function of speed, cut at the effort limit.
    """

    stiffness: float
    """Proportional gain [N m/rad]."""
    damping: float
    """Derivative gain [N m s/rad]."""
    effort_limit: float
    """Largest torque at any speed [N m]."""
    stall_torque: float
    """Torque at zero speed of the affine torque-speed line [N m]."""
    no_load_speed: float
    """Speed at which the affine line reaches zero torque [rad/s]."""
    rotor_inertia: float
    """Inertia that the rotor adds to the joint: its own times the gear ratio squared [kg m^2]."""

    def problem(self) -> str:
        """What is wrong with its figures, or an empty string."""
        for field in fields(self):
            value, least = getattr(self, field.name), field.name in ("damping", "rotor_inertia")
            sound = isinstance(value, int | float) and 0.0 <= value < math.inf and (least or value > 0.0)
            if not sound:
                return f"{field.name} must be a finite number {'of at least' if least else 'above'} 0, not {value!r}"
        if self.stall_torque < self.effort_limit:
            return f"stall_torque must be at least effort_limit, {self.effort_limit:g} N m, not {self.stall_torque:g}"
        return ""

    def asks(self, error_rad: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """The torque that PD asks for, before any limit [N m].

        Args:
            error_rad: joint target minus joint position [rad], any shape.
            speed: joint velocity [rad/s], the same shape.
        """
        return self.stiffness * error_rad - self.damping * speed


def add_motors(
    spec: mujoco.MjSpec, joint_names: Sequence[str], motors: Sequence[Motor], kind: MotorKind = "dc"
) -> None:
    """Add one actuator per joint, in order, and the rotors' inertia to a robot's spec.

    The inertia lets the drive keep its torque-speed limit at physics steps of 5 ms: without it the limit, which is
    taken at the start of a step, acts one step too late on a light shank.

    `dc` is MuJoCo's DC motor with a position input. At terminal voltage V it gives K / R * (V - K w), so limiting V to
    stall_torque * R / K limits the torque affinely in speed. K is free (only the ratio counts); R follows from the
    no-load speed V / K. `ideal` is PD with the effort limit alone. `network` takes a torque, which an actuator network
    computes outside MuJoCo at every physics step.
    """
    for name, motor in zip(joint_names, motors, strict=True):
        spec.joint(name).armature = motor.rotor_inertia
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if kind == "dc":
            voltage = motor.stall_torque
            constant = voltage / motor.no_load_speed
            resistance = constant * voltage / motor.stall_torque
            actuator.set_to_dcmotor(
                motorconst=[constant, constant],
                resistance=resistance,
                saturation=[motor.effort_limit, 0.0, 0.0],
                controller=[motor.stiffness, 0.0, motor.damping, 0.0, 0.0, voltage],
                ctrlspec=mujoco.mjtCtrlInput.mjINPUT_POS,
            )
        elif kind == "network":
            actuator.set_to_motor()
        else:
            actuator.set_to_position(kp=motor.stiffness, kv=motor.damping)
            actuator.forcelimited = True
            actuator.forcerange = [-motor.effort_limit, motor.effort_limit]
