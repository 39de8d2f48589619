"""Goals: a target with a deadline, a joystick, or way-points, and the target and time left that the policy gets."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from arrive.deployment.faults import BadInput
from arrive.deployment.specs import TaskSpec
from arrive.terms import LEAD_M, hold_time

FASTEST_S = 2.0
"""Time left at full stick: 3 m in 2 s [s]."""
SLOWEST_SHARE = 0.75
"""Time left at the slowest speed, as a share of the episode. Training had more only at the start of episodes."""
LEAST_S = 0.5
"""Smallest time left that the policy gets on the way to a target. When the time is up, it gets the hold time [s]."""
STICK_ACCELERATION = 2.0
"""Limit on the change of the commanded velocity while a stick drives. A reversal at full speed takes 1.5 s [m/s^2]."""
STOP_S = 0.5
"""When the stick is released, the robot stops where the commanded velocity would take it in this time, so that it does
not have to walk back [s]."""
DEAD_ZONE = 0.1
"""A stick closer to its centre than this means stop."""


@dataclass(frozen=True)
class Target:
    """Be at a point at a time, then stay there."""

    position_w: tuple[float, float, float]
    """Target position of the base frame's origin in the world [m]; in training `target_height_m` above the ground."""
    arrive_at_s: float
    """Time of arrival on the clock of `now_s` [s]."""

    def __post_init__(self) -> None:
        _set(self, position_w=_point(self.position_w), arrive_at_s=to_number(self.arrive_at_s))


@dataclass(frozen=True)
class Joystick:
    """Walk in a direction. Magnitudes above 1 are clamped to 1."""

    forward: float
    """-1 to 1, along the heading."""
    left: float
    """-1 to 1, perpendicular to the heading."""
    heading_rad: float | None = None
    """Heading in the world to which `forward` refers, e.g. the operator's; None for the robot's own [rad]."""

    def __post_init__(self) -> None:
        heading = None if self.heading_rad is None else to_number(self.heading_rad)
        _set(self, forward=to_number(self.forward), left=to_number(self.left), heading_rad=heading)


@dataclass(frozen=True)
class WayPoints:
    """Pass points one after the other without stopping, and stay at the last one."""

    points_w: tuple[tuple[float, float, float], ...]
    """Positions of the base in the world [m]."""
    speed: float = 1.0
    """Mean speed, clamped to the range of pseudo velocities [m/s]."""
    radius: float = 0.5
    """A point is passed once the base is horizontally this close to it [m]."""

    def __post_init__(self) -> None:
        try:
            points = tuple(_point(point) for point in self.points_w)
        except Exception:
            points = ()
        _set(self, points_w=points, speed=to_number(self.speed), radius=to_number(self.radius))


Goal = Target | Joystick | WayPoints


def to_number(value: Any) -> float:
    """The value as a float, or NaN if it is not a single number. The controller refuses NaN with a reason."""
    try:
        return float(value)
    except Exception:  # a control loop must outlive whatever a driver hands over
        return math.nan


def _point(point: Any) -> tuple[float, ...]:
    """The value as a tuple of floats, empty if it is not a point."""
    try:
        return tuple(to_number(x) for x in point)
    except Exception:
        return ()


def _set(goal: Any, **values: Any) -> None:
    """Set plain values in a frozen goal, so that it can be compared and logged."""
    for name, value in values.items():
        object.__setattr__(goal, name, value)


def walking_speeds(task: TaskSpec) -> tuple[float, float]:
    """Slowest and fastest pseudo velocity [m/s]."""
    slowest = LEAD_M / (SLOWEST_SHARE * task.episode_s)
    return slowest, max(slowest, LEAD_M / FASTEST_S)


def stick_pace(task: TaskSpec, magnitude: float) -> tuple[float, float]:
    """Distance [m] and time left [s] of the pseudo target. 3 m / time grows linearly from slowest to fastest speed.

    A `continuous` policy hurries whatever the time left is, so its distance is 3 m times the magnitude instead.
    """
    if task.name == "continuous":
        return LEAD_M * magnitude, hold_time(task)
    slowest, fastest = walking_speeds(task)
    speed = slowest + (fastest - slowest) * (magnitude - DEAD_ZONE) / (1.0 - DEAD_ZONE)
    return LEAD_M, LEAD_M / speed


def stick_magnitude(stick: Joystick) -> float:
    """Magnitude of a stick, 0 to 1; 0 inside the dead zone."""
    magnitude = min(1.0, math.hypot(stick.forward, stick.left))
    return 0.0 if magnitude < DEAD_ZONE else magnitude


def stick_speed(task: TaskSpec, stick: Joystick) -> float:
    """Pseudo velocity of a stick: distance over time left, 0 inside the dead zone [m/s]."""
    magnitude = stick_magnitude(stick)
    if not magnitude:
        return 0.0
    distance, left = stick_pace(task, magnitude)
    return distance / left


class Order(NamedTuple):
    """The command of one step."""

    target_w: np.ndarray
    """(3,) [m]."""
    time_left_s: float
    mode: str
    reason: str


class Navigator:
    """Turns a goal into a target and a time left, as in training.

    The time left stays within [`LEAST_S`, episode] until the deadline. After that it is the hold time: the reward
    window, at most half an episode. Training paid for standing at the target there, and it is far from the end of
    the episode, at which a robot may let itself fall.
    """

    def __init__(self, task: TaskSpec):
        """Start without a goal."""
        self._task = task
        self._hold_s = hold_time(task)
        self._reach = task.target_distance_m[1]
        self.reset()

    def reset(self) -> None:
        """Forget the progress along way-points and the position of the last stop."""
        self._path: WayPoints | None = None
        self._passed = 0
        self._deadline_s = 0.0
        self.release()

    def release(self) -> None:
        """Forget the position of the last stop and the last commanded velocity."""
        self._anchor: np.ndarray | None = None
        self._asked: np.ndarray | None = None
        self._asked_at_s = 0.0

    def order(self, goal: Goal | None, pos: np.ndarray, yaw: float, ground: float, now_s: float) -> Order:
        """The command for the policy at this step.

        Args:
            pos: (3,) base position in the world [m].
            yaw: heading [rad].
            ground: height of the ground around the robot [m].

        Raises:
            BadInput: there is no goal, or it is not finite.
        """
        if goal is None:
            raise BadInput("there is no goal")
        if not isinstance(goal, Joystick):
            self.release()
        if not isinstance(goal, WayPoints):
            self._path = None
        if isinstance(goal, Target):
            _check_finite("target", goal.position_w, 3, goal.arrive_at_s)
            return self._reach_for(np.array(goal.position_w), goal.arrive_at_s, pos, now_s, "target")
        if isinstance(goal, Joystick):
            return self._steer(goal, pos, yaw, ground, now_s)
        return self._follow(goal, pos, now_s)

    def _reach_for(self, target: np.ndarray, deadline_s: float, pos: np.ndarray, now_s: float, mode: str) -> Order:
        """Command for a target. If it is farther away than in training, command a closer point on the line to it."""
        way, left = target - pos, max(deadline_s - now_s, 0.0)
        distance = float(np.linalg.norm(way))
        reason = "" if left > 0.0 else "time is over"
        mode = mode if left > 0.0 else "hold"
        if distance > self._reach:
            share = self._reach / distance
            target, left = pos + way * share, left * share
            reason = f"{reason}{', ' if reason else ''}{distance:.3g} m away, led there {self._reach:g} m at a time"
        return Order(target, self._told(left), mode, reason)

    def _steer(self, stick: Joystick, pos: np.ndarray, yaw: float, ground: float, now_s: float) -> Order:
        """Pseudo-velocity control (paper, sections Energy Consumption and Hardware Deployment)."""
        heading = yaw if stick.heading_rad is None else stick.heading_rad
        if not all(map(math.isfinite, (stick.forward, stick.left, heading))):
            raise BadInput("the joystick is not finite")
        magnitude = stick_magnitude(stick)
        height = ground + self._task.target_height_m
        if not magnitude:
            if self._anchor is None:
                ahead = np.zeros(2) if self._asked is None else STOP_S * self._asked
                self._anchor = pos[:2] + ahead
            self._smooth(np.zeros(2), now_s)
            return Order(np.array([*self._anchor, height]), self._hold_s, "stop", "")
        self._anchor = None
        angle = heading + math.atan2(stick.left, stick.forward)
        distance, left = stick_pace(self._task, magnitude)
        velocity = self._smooth(distance / left * np.array([math.cos(angle), math.sin(angle)]), now_s)
        way, left = self._pull(velocity, left)
        return Order(np.array([pos[0] + way[0], pos[1] + way[1], height]), left, "joystick", "")

    def _smooth(self, wanted: np.ndarray, now_s: float) -> np.ndarray:
        """(2,) current pseudo velocity, which changes towards the wanted one with limited acceleration [m/s]."""
        if self._asked is not None:
            change = wanted - self._asked
            size = float(np.linalg.norm(change))
            most = STICK_ACCELERATION * max(now_s - self._asked_at_s, 0.0)
            if size > most:
                wanted = self._asked + change * (most / size)
        self._asked, self._asked_at_s = wanted, now_s
        return wanted

    def _pull(self, velocity: np.ndarray, left: float) -> tuple[np.ndarray, float]:
        """(2,) vector to the pseudo target [m] and time left [s]: 3 m away, or closer if the longest time is too short.

        Args:
            velocity: (2,) pseudo velocity [m/s].
            left: time left for a `continuous` policy, whatever the speed [s].
        """
        if self._task.name == "continuous":
            return velocity * left, left
        speed = float(np.linalg.norm(velocity))
        left = LEAD_M / max(speed, walking_speeds(self._task)[0])
        return velocity * left, left

    def _follow(self, path: WayPoints, pos: np.ndarray, now_s: float) -> Order:
        """Points before the last only give the direction of a pseudo target, so that the robot does not stop there."""
        for point in path.points_w:
            _check_finite("way-point", point, 3)
        if not path.points_w or not (math.isfinite(path.speed) and math.isfinite(path.radius)) or path.speed <= 0:
            raise BadInput("way-points need at least one point, a speed above 0 and a finite radius")
        if path != self._path:
            self._path, self._passed = path, 0
            self._deadline_s = self._arrival(path, pos, now_s)
        last = len(path.points_w) - 1
        while self._passed < last and math.dist(path.points_w[self._passed][:2], pos[:2]) <= path.radius:
            self._passed += 1
            self._deadline_s = self._arrival(path, pos, now_s)
        goal = np.array(path.points_w[self._passed])
        if self._passed == last:
            return self._reach_for(goal, self._deadline_s, pos, now_s, "way_points")
        way = goal[:2] - pos[:2]
        # The direction is undefined at the point itself. Unless the radius is 0, the next point takes over before.
        ahead = pos[:2] + way * (LEAD_M / max(float(np.linalg.norm(way)), 1e-6))
        left = LEAD_M / self._walk(path.speed)
        if self._task.name == "continuous":
            left = self._hold_s
        return Order(np.array([*ahead, goal[2]]), left, "way_points", f"{self._passed + 1} of {last + 1}")

    def _arrival(self, path: WayPoints, pos: np.ndarray, now_s: float) -> float:
        """Time at which the last point would be reached if it were next [s]."""
        return now_s + math.dist(path.points_w[-1], pos) / self._walk(path.speed)

    def _walk(self, speed: float) -> float:
        slowest, fastest = walking_speeds(self._task)
        return min(max(speed, slowest), fastest)

    def _told(self, time_left_s: float) -> float:
        return min(max(time_left_s, LEAST_S), self._task.episode_s) if time_left_s > 0.0 else self._hold_s


def _check_finite(what: str, point: tuple[float, ...], size: int, *others: float) -> None:
    if len(point) != size or not all(math.isfinite(x) for x in (*point, *others)):
        wanted = f"{size} finite numbers" + (" and a finite time" if others else "")
        raise BadInput(
            f"the {what} is not {wanted}: is the order {'position_w, arrive_at_s' if others else 'x, y, z'}?"
        )
