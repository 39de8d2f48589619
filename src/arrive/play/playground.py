"""One robot on one tile, run by the deployment controller and operated from the browser."""

import math
from collections import deque
from dataclasses import dataclass

import mujoco
import numpy as np

from arrive.deployment import Controller, Goal, JointCommand, Joystick, Target
from arrive.deployment.goals import DEAD_ZONE
from arrive.drive.driver import Driver
from arrive.errors import ArriveError
from arrive.physics.world import sensor_layout
from arrive.play.skills import Skill
from arrive.robots import get_robot
from arrive.simulation import SimulatedRobot, continued
from arrive.terrain.build import EVALUATION_TARGET
from arrive.terrain.ground import Ground
from arrive.terrain.tile import RASTER_HALF, Tile, cell_index

DURATION_S = 8.0
"""Default time to reach a target: the time that the paper's evaluation gives [s]."""
DURATIONS_S = (1.0, 12.0)
"""Shortest and longest time to reach a target [s]."""
MARGIN = 0.5
"""Targets keep this distance from the edge of the tile's raster [m]."""
FASTEST_PUSH = 3.0
"""Largest change of velocity by a push [m/s]."""
STOP = Joystick(0.0, 0.0)
MESSAGES = 5
"""Number of messages to keep."""
TERRAIN_GROUP = 0
"""Group of the terrain's geoms."""


@dataclass(frozen=True, eq=False)
class Reading:
    """The values that the panels show."""

    time_s: float
    speed: float
    """Horizontal speed of the base [m/s]."""
    distance: float
    """Distance to the target [m]; NaN if there is none."""
    torque: np.ndarray
    """(joints,) [N m]."""
    contact: np.ndarray
    """(feet,) bool."""


class Playground:
    """The simulation behind the page. It receives goals and pushes, and makes one control step at a time.

    The world frame is the tile's frame. A robot that crashes, falls or leaves the ground is put back to the start, and
    a message says why.
    """

    def __init__(self, skill: Skill, ground: Ground, seed: int = 1):
        """Put the robot on a terrain.

        Args:
            skill: the policy. Physics is as in its training.
            seed: seed of random terrain and of the directions of pushes.

        Raises:
            ArriveError: the terrain cannot be built, or the policy is for another configuration than this version's.
        """
        self.messages: deque[str] = deque(maxlen=MESSAGES)
        """Recent events, newest last."""
        self._seed, self._rng = seed, np.random.default_rng(seed)
        self.skill, self.ground = skill, ground
        self.driver = Driver(self._robot(skill, ground), Controller(skill.policy))
        self.goal: Goal = STOP
        self._start()
        self.aim = self._point(*first_aim(self.robot.tile, ground))
        """Position of the drawn target in the world, to which `go` sends the robot [m]."""

    def change(self, skill: Skill, ground: Ground) -> None:
        """Change robot, policy and ground.

        Raises:
            ArriveError: the terrain cannot be built, or the policy is for another configuration; nothing changes.
        """
        robot, controller = self._robot(skill, ground), Controller(skill.policy)
        self.driver.restart(robot, controller)
        self.skill, self.ground = skill, ground
        self._start()
        self.aim = self._point(*first_aim(robot.tile, ground))

    def learn(self, skill: Skill) -> None:
        """Continue from the current state with another network for the same robot.

        Raises:
            ArriveError: the policy is for another configuration; nothing changes.
        """
        self.driver.controller = Controller(skill.policy)
        self.skill = skill
        self.messages.append(f"{skill.name} after {skill.samples / 1e6:.1f} M samples")

    @property
    def robot(self) -> SimulatedRobot:
        """The robot on its tile."""
        return self.driver.robot

    @property
    def control_dt(self) -> float:
        """Length of a control step [s]."""
        return self.driver.control_dt

    @property
    def time_s(self) -> float:
        """Simulated time [s]. It never goes back."""
        return self.driver.time_s

    @property
    def falls(self) -> int:
        """Number of falls."""
        return self.driver.falls

    @property
    def target(self) -> Target | None:
        """The present target; None if the robot was given another goal since."""
        return self.goal if isinstance(self.goal, Target) else None

    @property
    def distance(self) -> float:
        """Distance from the base to the target [m]; NaN if there is none."""
        return math.dist(self.robot.base_pos_w, self.target.position_w) if self.target else math.nan

    @property
    def speed(self) -> float:
        """Horizontal speed of the base [m/s]."""
        return float(np.hypot(*self.robot.base_lin_vel_w[:2]))

    @property
    def is_there(self) -> bool:
        """Whether the robot is within the arrival radius of its target."""
        return self.distance < self.skill.policy.task.arrival_radius_m

    def step(self) -> None:
        """Make one control step."""
        step = self.driver.step(self.goal)
        self.command = step.command
        self._judge()
        if step.failure:
            self.messages.append(f"{step.failure}; put back to the start")
            self.driver.put_back()
            self.goal = STOP

    def read(self) -> Reading:
        """The current values for the panels."""
        data = self.robot.data
        return Reading(
            time_s=self.time_s,
            speed=self.speed,
            distance=self.distance,
            torque=data.actuator_force.copy(),
            contact=data.sensordata[sensor_layout(self.robot.robot).foot_contacts] > 0,
        )

    def feet(self) -> np.ndarray:
        """(feet, 3) centres of the feet in the world [m]."""
        return np.array([self.robot.data.site(name).xpos for name in self.robot.robot.foot_sites])

    def send(self, x: float, y: float, duration_s: float = DURATION_S) -> None:
        """Send the robot to a point, which it should reach in the given time.

        Args:
            x, y: point in the world [m]; clamped to the known ground.
            duration_s: time from now, within `DURATIONS_S` [s].

        Raises:
            ArriveError: the point is not finite, or the time is out of range.
        """
        if not (math.isfinite(x) and math.isfinite(y) and DURATIONS_S[0] <= duration_s <= DURATIONS_S[1]):
            low, high = DURATIONS_S
            raise ArriveError(
                f"a target needs a finite place and {low:g} to {high:g} s, not ({x}, {y}) in {duration_s} s"
            )
        edge = RASTER_HALF - MARGIN
        place = np.clip([x, y], -edge, edge)
        if not self.robot.tile.target_valid[*cell_index(place)]:
            self.messages.append("no target was ever here in training: it is in a hole or on a high obstacle")
        self.aim = self._point(*place.tolist())
        self.goal = Target(self.aim, self.time_s + duration_s)
        self._judged = False

    def go(self, duration_s: float = DURATION_S) -> None:
        """Send the robot to the drawn target; see `send`."""
        self.send(*self.aim[:2], duration_s)

    def drive(self, forward: float, left: float, heading_rad: float | None = None) -> None:
        """Walk as the stick commands. A centred stick stops the robot, unless it is walking to a target.

        Args:
            forward, left: -1 to 1.
            heading_rad: heading in the world that `forward` stands for [rad]; None for the robot's own heading.
        """
        if self.target is None or math.hypot(forward, left) >= DEAD_ZONE:
            self.goal = Joystick(forward, left, heading_rad)

    def push(self, speed: float) -> None:
        """Change the base's velocity at once in a random horizontal direction.

        Args:
            speed: change of velocity, 0 to `FASTEST_PUSH` [m/s].

        Raises:
            ArriveError: the speed is out of range.
        """
        if not 0.0 <= speed <= FASTEST_PUSH:
            raise ArriveError(f"a push is 0 to {FASTEST_PUSH:g} m/s, not {speed}")
        angle = self._rng.uniform(-math.pi, math.pi)
        self.robot.push((speed * math.cos(angle), speed * math.sin(angle)))
        self.messages.append(f"pushed by {speed:.1f} m/s")

    def reset(self) -> None:
        """Put the robot back to the start, without a goal."""
        self.messages.append("put back to the start")
        self.driver.restart()
        self._start()

    def hit(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
        """(3,) point where a ray hits the terrain, in the world [m]; None if it misses or has no direction."""
        length = float(np.linalg.norm(direction))
        if not (np.isfinite(origin).all() and math.isfinite(length) and length > 1e-9):
            return None
        groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        groups[TERRAIN_GROUP] = 1
        model, data, direction = self.robot.model, self.robot.data, direction / length
        distance = mujoco.mj_ray(model, data, origin, direction, groups, 1, -1, None)
        return origin + distance * direction if distance >= 0.0 else None

    def _robot(self, skill: Skill, ground: Ground) -> SimulatedRobot:
        return SimulatedRobot(
            skill.config, continued(ground.build(self._seed, get_robot(skill.config.robot).size)), visuals=True
        )

    def _start(self) -> None:
        """Clear goal and command of the time before a reset."""
        self.goal = STOP
        self.command = JointCommand(np.array(self.robot.robot.default_joint_pos), "stop", "")
        self._judged = True

    def _judge(self) -> None:
        """When the time is up, add one message: whether the robot is at its target."""
        if self._judged or self.target is None or self.time_s < self.target.arrive_at_s - 1e-6:
            return
        verdict = "arrived" if self.is_there else "not there in time"
        self.messages.append(f"{verdict}: {self.distance:.2f} m from the target")
        self._judged = True

    def _point(self, x: float, y: float) -> tuple[float, float, float]:
        """A target above a point on the ground, at the same height as in training [m]."""
        ground = float(self.robot.tile.heights[*cell_index(np.array([x, y]))])
        return x, y, ground + self.skill.policy.task.target_height_m


def first_aim(tile: Tile, ground: Ground) -> tuple[float, float]:
    """(x, y) of the first target: the evaluation's, or the nearest valid one straight ahead, beyond the terrain [m]."""
    x, y = EVALUATION_TARGET
    if ground.layout == "evaluation":
        return x, y
    places = np.arange(1.0, RASTER_HALF - MARGIN, 0.1)
    cells = cell_index(places), cell_index(np.full(len(places), y))
    fit = places[tile.target_valid[cells] & tile.crossing[cells]]
    return (float(fit[np.abs(fit - x).argmin()]), y) if len(fit) else (x, y)
