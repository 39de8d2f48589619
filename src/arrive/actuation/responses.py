"""Responses of a motor to a step, a sine and a constant speed, to compare motors."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from arrive.actuation.clip import MotorClip, TorqueClip
from arrive.actuation.motor import Motor
from arrive.actuation.network import ActuatorNetwork
from arrive.actuation.runtime import make_runtime

Law = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(joints,) position errors [rad] and velocities [rad/s] to torques [N m], one call per period."""

CYCLES, LEAST_S = 3, 1.0
"""A frequency is measured over so many cycles and at least so long, after as long for settling."""


@dataclass(frozen=True)
class DriveModel:
    """A motor to compare: its law without limits, its period, and its limits."""

    name: str
    make_law: Callable[[int], Law]
    """The law for so many joints, at rest."""
    period_s: float
    clip: MotorClip


def network_drive(name: str, network: ActuatorNetwork, clip: MotorClip) -> DriveModel:
    """A network with the clip of `physics.motor_clip`."""
    return DriveModel(name, lambda joints: make_runtime(network, joints).step, network.period_s, clip)


def pd_drive(name: str, motor: Motor, period_s: float, clip: MotorClip) -> DriveModel:
    """The PD law of a robot's motor: `dc` with the clip `affine`, `ideal` with `constant`."""
    return DriveModel(name, lambda joints: motor.asks, period_s, clip)


def locked_step(drive: DriveModel, motor: Motor, step_rad: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Torque of a joint that cannot move after its target has jumped.

    Returns:
        Time of each call since the jump [s], and the torque from then on [N m].
    """
    law, error, still = drive.make_law(1), np.full(1, step_rad), np.zeros(1)
    torques = [_clipped(drive, motor, law(error, still), still)[0] for _ in range(round(seconds / drive.period_s))]
    return np.arange(len(torques)) * drive.period_s, np.array(torques)


def loaded_step(
    drive: DriveModel, motor: Motor, step_rad: float, inertia: float, seconds: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position of a joint that turns a load after its target has jumped, as a simulation steps it.

    Args:
        inertia: of load and rotor together [kg m^2].

    Returns:
        Time since the jump [s], and the position [rad].
    """
    law, position, velocity, path = drive.make_law(1), np.zeros(1), np.zeros(1), []
    for _ in range(round(seconds / drive.period_s)):
        path.append(position[0])
        torque = _clipped(drive, motor, law(step_rad - position, velocity), velocity)
        velocity = velocity + drive.period_s * torque / inertia  # the new speed moves it: MuJoCo's order
        position = position + drive.period_s * velocity
    return np.arange(len(path)) * drive.period_s, np.array(path)


def frequency_response(drive: DriveModel, frequencies_hz: np.ndarray, amplitude_rad: float) -> np.ndarray:
    """Torque of a joint that cannot move for a sine of its target, before the clip.

    Args:
        frequencies_hz: (n,) below half of the drive's rate.

    Returns:
        (n,) complex torque per target [N m/rad]: its magnitude is a stiffness, its angle the lag.
    """
    settle_s = np.maximum(CYCLES / frequencies_hz, LEAST_S)
    steps = int(np.ceil(2 * settle_s.max() / drive.period_s))
    law, still = drive.make_law(len(frequencies_hz)), np.zeros(len(frequencies_hz))
    time = np.arange(steps) * drive.period_s
    turns = np.exp(2j * np.pi * frequencies_hz * time[:, None])
    torque = np.array([law(amplitude_rad * turn.imag, still).copy() for turn in turns])
    answers = []
    for column, start in enumerate(settle_s):
        kept = time >= start
        # Least squares on sine, cosine and an offset, so that the window need not be whole cycles.
        wave = turns[kept, column]
        basis = np.stack([wave.imag, wave.real, np.ones(kept.sum())], axis=1)
        sine, cosine, _ = np.linalg.lstsq(basis, torque[kept, column], rcond=None)[0]
        answers.append((sine + 1j * cosine) / amplitude_rad)
    return np.array(answers)


def torque_at_speed(
    drive: DriveModel, motor: Motor, error_rad: float, speeds: np.ndarray, seconds: float = 0.5
) -> tuple[np.ndarray, np.ndarray]:
    """Torque at a constant speed with a constant position error, once it has settled.

    Returns:
        (n,) before the clip and after it [N m].
    """
    law, error = drive.make_law(len(speeds)), np.full(len(speeds), error_rad)
    for _ in range(round(seconds / drive.period_s)):
        torque = law(error, speeds).copy()
    return torque, _clipped(drive, motor, torque, speeds)


def _clipped(drive: DriveModel, motor: Motor, torque: np.ndarray, speed: np.ndarray) -> np.ndarray:
    torque = np.array(torque, dtype=np.float64)
    TorqueClip([motor], drive.clip).cut(torque, speed)
    return torque
