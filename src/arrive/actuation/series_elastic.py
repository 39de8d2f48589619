"""A series-elastic drive in detail: a source of logs for those who have no drive at hand, and a truth to fit.

    rotor, gear -- torsion spring -- joint with its load

The drive reads its target late, asks for a torque by PD on the joint's position, and tracks it on the spring's torque.
"""

from dataclasses import dataclass

import numpy as np

from arrive.actuation.clip import affine_limits

FINE_STEP_S = 2e-4
"""Integration step; the torque loop is 30 times slower [s]."""


@dataclass(frozen=True)
class SeriesElasticDrive:
    """An ANYdrive-like drive. Figures without a source are assumed, at the size that such drives have."""

    rotor_inertia: float = 2e-5
    """About the motor's axis; assumed: frameless motors of this class have 1e-5 to 4e-5 [kg m^2]."""
    gear_ratio: float = 76.8
    """Makes 5,500 rpm, the motor speed limit in a published ANYmal C configuration, the 7.5 rad/s of Isaac Lab's
    ANYdrive 3."""
    spring_stiffness: float = 350.0
    """Assumed: as StarlETH's joints, a forerunner's; 80 N m twist it by 13 degrees [N m/rad]."""
    spring_damping: float = 1.0
    """Assumed [N m s/rad]."""
    coulomb_friction: float = 4.0
    """At the joint; assumed: 5 % of the largest torque, as harmonic drives lose [N m]."""
    viscous_friction: float = 0.5
    """At the joint; assumed [N m s/rad]."""
    torque_constant: float = 0.075
    """Assumed, so that 15 A give 80 N m at the joint after friction [N m/A]."""
    current_limit: float = 15.0
    """Of a published ANYmal C configuration [A]."""
    stall_torque: float = 120.0
    """Of the torque-speed line that the supply voltage sets, Isaac Lab's ANYdrive 3 [N m]."""
    no_load_speed: float = 7.5
    """The same line's [rad/s]."""
    delay_s: float = 0.004
    """From a target's sending to its use; assumed: two cycles of a bus and a controller at 400 Hz, less a half [s]."""
    stiffness: float = 80.0
    """Gain of the joint's position, legged_gym's for ANYmal C [N m/rad]."""
    damping: float = 2.0
    """Gain of the joint's velocity, legged_gym's for ANYmal C [N m s/rad]."""
    torque_gain: float = 8.0
    """Of the torque loop, proportional; a published ANYmal C configuration."""
    torque_damping: float = 22.0
    """Of the torque loop, on the spring's rate; the same configuration [N m s/rad]."""
    effort_limit: float = 80.0
    """Largest torque that the position loop asks for, Isaac Lab's ANYdrive 3 [N m]."""

    @property
    def reflected_inertia(self) -> float:
        """The rotor's inertia as the joint feels it [kg m^2]."""
        return self.rotor_inertia * self.gear_ratio**2

    def motor_torque(self, wanted: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """The torque behind the gear within current and voltage, at the rotor's speed behind the gear [N m]."""
        current = self.gear_ratio * self.torque_constant * self.current_limit
        slope = self.stall_torque / self.no_load_speed
        return np.clip(wanted, *affine_limits(self.stall_torque, slope, current, speed))


@dataclass(frozen=True)
class Load:
    """What hangs at each joint of a test bench: (num_joints,) each, and what else pushes."""

    inertia: np.ndarray
    """About the joint [kg m^2]."""
    gravity_torque: np.ndarray
    """Of a pendulum held out horizontally [N m]."""
    damping: np.ndarray
    """Of a brake at the joint, as ground under a foot has it [N m s/rad]."""
    push: np.ndarray
    """(steps, num_joints) torque from outside [N m]."""


def simulate(drive: SeriesElasticDrive, targets: np.ndarray, load: Load, period_s: float) -> dict[str, np.ndarray]:
    """Run drives of one kind side by side, and log them as a robot would.

    Args:
        targets: (steps, num_joints) joint targets, one per period [rad].
        period_s: of the log, a multiple of `FINE_STEP_S` [s].

    Returns:
        `time` (steps,) [s], and (steps, num_joints) `target` as sent [rad], `position` [rad], `velocity` [rad/s] and
        `torque` of the spring [N m], averaged over the period that follows: what a simulation needs at a step's start
        to move the joint through that step.
    """
    fine, lag = round(period_s / FINE_STEP_S), round(drive.delay_s / FINE_STEP_S)
    steps, joints = targets.shape
    logged = {name: np.empty((steps, joints)) for name in ("position", "velocity", "torque")}
    position, velocity, rotor, rotor_speed = np.zeros((4, joints))
    position += targets[0]
    rotor += targets[0]
    for step in range(steps):
        logged["position"][step], logged["velocity"][step] = position, velocity
        total = np.zeros(joints)
        for sub in range(fine):
            target = targets[max((step * fine + sub - lag) // fine, 0)]
            spring, motor = _torques(drive, target, position, velocity, rotor, rotor_speed)
            outside = load.push[step] - load.gravity_torque * np.sin(position) - load.damping * velocity
            rotor_speed += FINE_STEP_S * (motor - spring) / drive.reflected_inertia
            velocity += FINE_STEP_S * (spring + outside) / load.inertia
            rotor += FINE_STEP_S * rotor_speed
            position += FINE_STEP_S * velocity
            total += spring
        logged["torque"][step] = total / fine
    return {"time": np.arange(steps) * period_s, "target": targets, **logged}


def _torques(
    drive: SeriesElasticDrive,
    target: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    rotor: np.ndarray,
    rotor_speed: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Torque of the spring on the joint, and of the motor after friction on the rotor, both at the joint [N m]."""
    twist_rate = rotor_speed - velocity
    spring = drive.spring_stiffness * (rotor - position) + drive.spring_damping * twist_rate
    asked = drive.stiffness * (target - position) - drive.damping * velocity
    asked = np.clip(asked, -drive.effort_limit, drive.effort_limit)
    wanted = asked + drive.torque_gain * (asked - spring) - drive.torque_damping * twist_rate
    # A steep tanh instead of a sign, so that a rotor at rest does not chatter.
    friction = drive.coulomb_friction * np.tanh(rotor_speed / 0.05) + drive.viscous_friction * rotor_speed
    return spring, drive.motor_torque(wanted, rotor_speed) - friction
