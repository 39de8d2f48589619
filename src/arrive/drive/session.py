"""The drive: sticks in, one control step at a time, and what came of it."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from arrive.deployment import Controller, Joystick
from arrive.deployment.goals import stick_speed
from arrive.simulation import SimulatedRobot

LARGEST_DELAY_S = 0.2
"""Real time that is caught up with; what is later than that is lost, and the robot lags [s]."""


class Controls(Protocol):
    """A gamepad or a file."""

    def stick(self, time_s: float, yaw: float) -> Joystick:
        """The stick at a time of the drive [s], given the robot's heading [rad]."""

    def close(self) -> None:
        """Give devices back."""


@dataclass(frozen=True)
class Moment:
    """One control step of a drive."""

    time_s: float
    commanded_speed: float
    """Distance over remaining time of the pseudo target; 0 where the robot is to stop [m/s]."""
    commanded_angle: float
    """Direction in the world, of no meaning where the robot is to stop [rad]."""
    velocity_w: np.ndarray
    """(2,) horizontal velocity of the base in the world [m/s]."""
    yaw: float
    """Heading [rad]."""
    mode: str
    """Of the controller."""
    fell: bool
    """Whether the robot crashed, fell or left the ground in this step, and was put back to the start."""

    @property
    def along(self) -> float:
        """Velocity in the commanded direction [m/s]."""
        return float(self.velocity_w @ (math.cos(self.commanded_angle), math.sin(self.commanded_angle)))


@dataclass
class Tally:
    """A drive so far."""

    time_s: float = 0.0
    falls: int = 0
    driven_s: float = 0.0
    """Time in which the policy followed a stick [s]."""
    commanded_m: float = 0.0
    """Integral of the commanded speed over that time [m]."""
    along_m: float = 0.0
    """Way made in the commanded directions over that time [m]."""
    late_s: float = 0.0
    """Real time that was lost because steps took too long [s]."""

    def add(self, moment: Moment, dt: float) -> None:
        """Take in a step of `dt` [s]."""
        self.time_s, self.falls = moment.time_s, self.falls + moment.fell
        if moment.mode == "joystick":
            self.driven_s += dt
            self.commanded_m += moment.commanded_speed * dt
            self.along_m += moment.along * dt


class Drive:
    """A controller on a simulated robot.

    A robot that crashes, falls or leaves the ground is put back to the tile's start with its heading, and the
    controller is given no goal for one step: it goes to its safe stance and recovers as it would on a robot.
    """

    def __init__(self, robot: SimulatedRobot, controller: Controller):
        """Both as they were made, at their start."""
        self.robot, self.controller = robot, controller
        self.time_s = 0.0
        """Never goes back, unlike the robot's own clock [s]."""
        self._fell = False

    def step(self, stick: Joystick) -> Moment:
        """One control step."""
        robot, now_s, yaw = self.robot, self.time_s, self.robot.yaw
        goal = None if self._fell else stick
        command = self.controller.step(robot.sensors(now_s), goal, robot.height_map(now_s), now_s)
        robot.step(command.targets)
        self.time_s += robot.control_dt
        self._fell = robot.crashed or robot.fell or robot.left_ground
        heading = yaw if stick.heading_rad is None else stick.heading_rad
        moment = Moment(
            time_s=self.time_s,
            commanded_speed=stick_speed(self.controller.policy.task, stick),
            commanded_angle=heading + math.atan2(stick.left, stick.forward),
            velocity_w=robot.base_lin_vel_w[:2],
            yaw=yaw,
            mode=command.mode,
            fell=self._fell,
        )
        if self._fell:
            robot.reset(yaw=yaw)
        return moment


def run(
    drive: Drive,
    controls: Controls,
    seconds: float,
    report: Callable[[Moment, Tally], None],
    real_time: bool,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Tally:
    """Drive for a while; Ctrl-C ends it early.

    Args:
        seconds: may be infinite [s].
        report: told every step.
        real_time: a step each 20 ms by the clock, or as fast as the machine can.

    Raises:
        ArriveError: the gamepad was disconnected.
    """
    tally, dt = Tally(), drive.robot.control_dt
    due_s = clock()
    try:
        for _ in range(round(seconds / dt)) if math.isfinite(seconds) else iter(int, 1):
            moment = drive.step(controls.stick(drive.time_s, drive.robot.yaw))
            tally.add(moment, dt)
            report(moment, tally)
            if real_time:
                due_s = _wait(due_s + dt, tally, clock, sleep)
    except KeyboardInterrupt:
        pass
    return tally


def _wait(due_s: float, tally: Tally, clock: Callable[[], float], sleep: Callable[[float], None]) -> float:
    """Wait until a step is due; returns when the next one counts from [s]."""
    early_s = due_s - clock()
    if early_s > 0.0:
        sleep(early_s)
    lost_s = max(-early_s - LARGEST_DELAY_S, 0.0)
    tally.late_s += lost_s
    return due_s + lost_s
