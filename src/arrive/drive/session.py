"""A drive: control steps with stick commands, and their results."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from arrive.deployment import Joystick
from arrive.deployment.goals import stick_speed
from arrive.drive.driver import Driver
from arrive.drive.pace import Pace


class Controls(Protocol):
    """A gamepad or a script."""

    def stick(self, time_s: float, yaw: float) -> Joystick:
        """The stick at a time of the drive [s], given the robot's heading [rad]."""

    def close(self) -> None:
        """Release devices."""


@dataclass(frozen=True)
class DriveSample:
    """One control step of a drive."""

    time_s: float
    commanded_speed: float
    """Distance over time left of the pseudo target; 0 if the command is to stop [m/s]."""
    commanded_angle: float
    """Direction in the world; without meaning if the command is to stop [rad]."""
    velocity_w: np.ndarray
    """(2,) horizontal velocity of the base in the world [m/s]."""
    yaw: float
    """Heading [rad]."""
    mode: str
    """Mode of the controller."""
    fell: bool
    """Whether the robot crashed, fell or left the ground in this step, and was put back to the start."""

    @property
    def along(self) -> float:
        """Velocity in the commanded direction [m/s]."""
        return float(self.velocity_w @ (math.cos(self.commanded_angle), math.sin(self.commanded_angle)))


@dataclass
class DriveStatistics:
    """Totals of a drive so far."""

    time_s: float = 0.0
    falls: int = 0
    driven_s: float = 0.0
    """Time in which the policy followed a stick [s]."""
    commanded_m: float = 0.0
    """Integral of the commanded speed over that time [m]."""
    along_m: float = 0.0
    """Distance walked along the commanded directions in that time [m]."""
    late_s: float = 0.0
    """Real time lost because steps took too long [s]."""

    def add(self, sample: DriveSample, dt: float) -> None:
        """Add a step of `dt` [s]."""
        self.time_s, self.falls = sample.time_s, self.falls + sample.fell
        if sample.mode == "joystick":
            self.driven_s += dt
            self.commanded_m += sample.commanded_speed * dt
            self.along_m += sample.along * dt


def advance(driver: Driver, stick: Joystick) -> DriveSample:
    """Make one control step with a stick command. A robot that fails is put back to the start."""
    yaw = driver.robot.yaw
    step = driver.step(stick)
    heading = yaw if stick.heading_rad is None else stick.heading_rad
    sample = DriveSample(
        time_s=driver.time_s,
        commanded_speed=stick_speed(driver.controller.policy.task, stick),
        commanded_angle=heading + math.atan2(stick.left, stick.forward),
        velocity_w=driver.robot.base_lin_vel_w[:2],
        yaw=yaw,
        mode=step.command.mode,
        fell=bool(step.failure),
    )
    if step.failure:
        driver.put_back()
    return sample


def run(
    driver: Driver,
    controls: Controls,
    seconds: float,
    report: Callable[[DriveSample, DriveStatistics], None],
    real_time: bool,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
    stop: Callable[[], bool] = lambda: False,
) -> DriveStatistics:
    """Drive for some time. Ctrl-C ends it early.

    Args:
        seconds: duration, may be infinite [s].
        report: called after every step.
        real_time: run in real time instead of as fast as the machine can.
        stop: asked after every step whether to end early.

    Raises:
        ArriveError: the gamepad was disconnected.
    """
    statistics, pace = DriveStatistics(), Pace(driver.control_dt)
    left = round(seconds / driver.control_dt) if math.isfinite(seconds) else math.inf
    try:
        while left > 0 and not stop():
            due = min(left, pace.steps_due(clock()) if real_time else 1)
            for _ in range(int(due)):
                sample = advance(driver, controls.stick(driver.time_s, driver.robot.yaw))
                statistics.add(sample, driver.control_dt)
                report(sample, statistics)
                if stop():
                    break
            left -= due
            statistics.late_s = pace.dropped_s
            if real_time and left > 0:
                sleep(max(0.0, pace.next_s - clock()))
    except KeyboardInterrupt:
        pass
    return statistics
