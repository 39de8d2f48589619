"""Checks in every step whether the inputs are plausible."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from arrive.deployment.faults import BadInput, Fallen
from arrive.deployment.inputs import Frame
from arrive.deployment.safety import Safety
from arrive.deployment.specs import RobotSpec
from arrive.rotation import angle_between, tilt

STILL_SHARE = 0.05
"""If the clock advances by less than this share of the control period in a step, it stands still."""


class Verdict(NamedTuple):
    """Result of the checks of one step."""

    fault: BadInput | None
    """The first fault, or None."""
    sensors_good: bool
    """Whether at least the robot's state is plausible."""


class Watchdog:
    """Compares inputs with the robot's limits, and with the inputs of the last step."""

    def __init__(self, robot: RobotSpec, points: int, period_s: float, safety: Safety):
        """Store the robot's ranges.

        Args:
            points: number of heights.
            period_s: control period [s].
        """
        joints = len(robot.joint_names)
        self._safety, self._names, self._points = safety, robot.joint_names, points
        self._sizes = {
            "joint_pos": joints,
            "joint_vel": joints,
            "base_pos_w": 3,
            "base_quat_w": 4,
            "base_lin_vel_b": 3,
            "base_ang_vel_b": 3,
        }
        low, high = np.array(robot.joint_limits_rad).T
        self._middle, self._half = (low + high) / 2, (high - low) / 2
        self._joint_speed = safety.joint_speed_share * float(np.max(robot.no_load_speed))
        self._least_tick = STILL_SHARE * period_s
        self.reset()

    def reset(self) -> None:
        """Forget the last step."""
        self._before: Frame | None = None
        self._now_s: float | None = None
        self._still = 0

    def judge(self, frame: Frame) -> Verdict:
        """Whether the policy may act on a frame, which is stored for the next step."""
        sensors = self._first_fault(frame, self._check_whole, self._check_age, self._check_ranges, self._check_jumps)
        # In this order, so that the reported reason is the cause and not its consequence.
        fault = self._first_fault(frame, self._check_clock, self._check_arguments) or sensors
        if fault is None:
            fault = self._first_fault(frame, self._check_tilt, self._check_terrain)
        self._remember(frame)
        return Verdict(fault, sensors is None)

    @staticmethod
    def _first_fault(frame: Frame, *checks: Callable[[Frame], None]) -> BadInput | None:
        try:
            for check in checks:
                check(frame)
        except BadInput as fault:
            return fault
        return None

    def _remember(self, frame: Frame) -> None:
        if math.isfinite(frame.now_s):
            self._now_s = frame.now_s
        if self._first_fault(frame, self._check_whole) is None:
            self._before = frame

    def _check_clock(self, frame: Frame) -> None:
        if not math.isfinite(frame.now_s):
            raise BadInput("the clock is not a number")
        if self._now_s is None:
            return
        if frame.now_s < self._now_s:
            raise BadInput("the clock went back")
        if not frame.now_s - self._now_s <= self._safety.gap_s:
            raise BadInput(f"the clock went on by {frame.now_s - self._now_s:.3g} in one step: is it in seconds?")
        self._still = self._still + 1 if frame.now_s - self._now_s < self._least_tick else 0
        if self._still >= self._safety.still_steps:
            raise BadInput(f"the clock stands still at {frame.now_s:.6g} s")

    def _check_arguments(self, frame: Frame) -> None:
        if frame.mistake:
            raise BadInput(frame.mistake)

    def _check_whole(self, frame: Frame) -> None:
        for name, size in self._sizes.items():
            value = getattr(frame, name)
            if value.shape != (size,):
                raise BadInput(f"{name} is not {size} numbers but an array of the shape {value.shape}")
            if not np.isfinite(value).all():
                raise BadInput(f"{name} is not finite")
        if not abs(float(frame.base_quat_w @ frame.base_quat_w) - 1.0) <= 0.1:
            raise BadInput("base_quat_w is not a unit quaternion")

    def _check_age(self, frame: Frame) -> None:
        _check_age("sensors", frame.sensors_time_s, frame.now_s, self._safety.sensors_age_s)

    def _check_ranges(self, frame: Frame) -> None:
        safety = self._safety
        outside = np.abs(frame.joint_pos - self._middle) - self._half
        if not outside.max() <= safety.joint_margin_rad:
            i = int(outside.argmax())
            raise BadInput(
                f"joint_pos of {self._names[i]} is {frame.joint_pos[i]:.4g} rad, {outside[i]:.3g} rad outside its "
                "range: is it in degrees?"
            )
        for name, unit, value, most in (
            ("joint_vel", "rad/s", np.abs(frame.joint_vel).max(), self._joint_speed),
            ("base_lin_vel_b", "m/s", np.abs(frame.base_lin_vel_b).max(), safety.base_speed_m_s),
            ("base_ang_vel_b", "rad/s", np.abs(frame.base_ang_vel_b).max(), safety.base_rate_rad_s),
        ):
            if not value <= most:
                raise BadInput(f"{name} reaches {value:.4g} {unit}, more than {most:g} {unit}: is it in another unit?")

    def _check_jumps(self, frame: Frame) -> None:
        before, safety = self._before, self._safety
        if before is None:
            return
        # Time stamps may advance by more than the clock when a new measurement follows a late one.
        dt = max(frame.now_s - before.now_s, frame.sensors_time_s - before.sensors_time_s, 0.0)
        for name, unit, change, speed in (
            ("joint_pos", "rad", np.abs(frame.joint_pos - before.joint_pos).max(), self._joint_speed),
            ("base_pos_w", "m", np.abs(frame.base_pos_w - before.base_pos_w).max(), safety.base_speed_m_s),
            ("base_quat_w", "rad", angle_between(frame.base_quat_w, before.base_quat_w), safety.base_rate_rad_s),
        ):
            if not change <= speed * dt + safety.jump:
                raise BadInput(f"{name} jumped by {change:.3g} {unit} in {dt:.3g} s")

    def _check_tilt(self, frame: Frame) -> None:
        angle = tilt(frame.base_quat_w)
        if not angle <= self._safety.tilt_rad:
            raise Fallen(f"the base is tilted by {angle:.2f} rad, more than {self._safety.tilt_rad:g} rad")

    def _check_terrain(self, frame: Frame) -> None:
        """Check the heights. NaN is an unseen point."""
        if frame.heights_w.shape != (self._points,):
            raise BadInput(f"heights are not {self._points} numbers, a height map or a point cloud")
        if np.isinf(frame.heights_w).any():
            raise BadInput("heights are infinite")
        _check_age("heights", frame.terrain_time_s, frame.now_s, self._safety.terrain_age_s)


def _check_age(what: str, time_s: float, now_s: float, limit_s: float) -> None:
    age = now_s - time_s
    if not abs(age) <= limit_s:
        raise BadInput(f"{what} are {age:.3g} s old, more than {limit_s:g} s from now")
