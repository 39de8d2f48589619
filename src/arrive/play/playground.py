"""One robot on one tile, run by the deployment controller: what a person in the browser plays with."""

import math
from collections import deque
from dataclasses import dataclass

import mujoco
import numpy as np

from arrive.config import Config, from_dict
from arrive.deployment import Controller, Goal, JointCommand, Joystick, Target
from arrive.deployment.goals import DEAD_ZONE
from arrive.deployment.policy_file import PolicyFile
from arrive.errors import ArriveError
from arrive.physics.world import sensor_layout
from arrive.simulation import SimulatedRobot, continued, make_tile
from arrive.terrain import get_family
from arrive.terrain.tile import RASTER_HALF, cell_index

LEVELS = 10
"""Levels between each family's easiest and hardest parameter, as in training."""
MARGIN = 0.5
"""Targets stay this far within the tile's raster [m]."""
STOP = Joystick(0.0, 0.0)
MESSAGES = 5
"""Messages that are kept."""
TERRAIN_GROUP = 0
"""Group of the terrain's geoms."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What the panels show of one moment."""

    time_s: float
    speed: float
    """Of the base, horizontal [m/s]."""
    distance: float
    """To the target, NaN where there is none [m]."""
    torque: np.ndarray
    """(joints,) [N m]."""
    contact: np.ndarray
    """(feet,) bool."""


class Playground:
    """The simulation behind the page: it is told goals and pushes, and makes one control step at a time.

    The world frame is the tile's. A robot that crashes, falls or leaves the ground is put back to the start, and a
    message says why.
    """

    def __init__(self, policy: PolicyFile, terrain: str = "flat", level: int = 0, seed: int = 1):
        """Stand the robot on a terrain.

        Args:
            policy: decides the physics too: that of its training.
            seed: of random terrain and of the direction of pushes.

        Raises:
            ArriveError: no such terrain or level, or the policy is for another configuration than this version's.
        """
        self.config: Config = from_dict(Config, policy.meta["training"]["config"])
        self.controller = Controller(policy)
        self.messages: deque[str] = deque(maxlen=MESSAGES)
        """What happened, newest last."""
        self.time_s = 0.0
        """Simulated so far; unlike the robot's own clock it never goes back [s]."""
        self.falls = 0
        self._seed, self._rng = seed, np.random.default_rng(seed)
        self.change_terrain(terrain, level)

    def change_terrain(self, terrain: str, level: int) -> None:
        """Put the robot on another tile.

        Raises:
            ArriveError: no such terrain or level; nothing changes.
        """
        tile = make_tile(terrain, level, levels=LEVELS, seed=self._seed)
        self.robot = SimulatedRobot(self.config, continued(tile), visuals=True)
        self.terrain, self.level = terrain, level
        self._feet = sensor_layout(self.robot.robot).foot_contacts
        self.messages.append(f"on {self.ground}")
        self._start()

    @property
    def ground(self) -> str:
        """The terrain in words."""
        family = get_family(self.terrain)
        if family.lowest == family.highest:
            return family.description
        return f"{family.description}, {family.parameter} {family.value(self.level, LEVELS):.2g} {family.unit}".strip()

    @property
    def control_dt(self) -> float:
        """Simulated time of a step [s]."""
        return self.robot.control_dt

    @property
    def target(self) -> Target | None:
        """The target the robot was last sent to and still is."""
        return self.goal if isinstance(self.goal, Target) else None

    @property
    def distance(self) -> float:
        """From the base to the target, NaN where there is none [m]."""
        return math.dist(self.robot.base_pos_w, self.target.position_w) if self.target else math.nan

    def step(self) -> None:
        """Make one control step."""
        now_s = self.time_s
        sensors, heights = self.robot.sensors(now_s), self.robot.height_map(now_s)
        self.command: JointCommand = self.controller.step(sensors, self.goal, heights, now_s)
        self.robot.step(self.command.targets)
        self.time_s += self.control_dt
        self._judge()
        self._look_after()

    def read(self) -> Reading:
        """What the panels show now."""
        data = self.robot.data
        return Reading(
            time_s=self.time_s,
            speed=float(np.hypot(*self.robot.base_lin_vel_w[:2])),
            distance=self.distance,
            torque=data.actuator_force.copy(),
            contact=data.sensordata[self._feet] > 0,
        )

    def send(self, x: float, y: float, duration_s: float) -> None:
        """Send the robot to a place, to be there in a while.

        Args:
            x, y: in the world, cut to where the ground is known [m].
            duration_s: from now [s].

        Raises:
            ArriveError: not finite, or no time to get there.
        """
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(duration_s) and duration_s > 0.0):
            raise ArriveError(f"a target needs a finite place and a time above 0 s, not ({x}, {y}) in {duration_s} s")
        edge = RASTER_HALF - MARGIN
        place = np.clip([x, y], -edge, edge)
        if not self.robot.tile.target_valid[*cell_index(place)]:
            self.messages.append("no target was ever here in training: it is in a hole or on a high obstacle")
        height = self._ground_height(place) + self.controller.policy.task.target_height_m
        self.goal = Target((*place.tolist(), height), self.time_s + duration_s)
        self._judged = False

    def drive(self, forward: float, left: float, heading_rad: float | None = None) -> None:
        """Walk as a stick says; in its middle the robot stops, unless it is on the way to a target.

        Args:
            forward, left: -1 to 1.
            heading_rad: heading in the world that `forward` means; None for the robot's own [rad].
        """
        if self.target is None or math.hypot(forward, left) >= DEAD_ZONE:
            self.goal = Joystick(forward, left, heading_rad)

    def push(self, speed: float) -> None:
        """Change the base's velocity at once in a random horizontal direction [m/s]."""
        angle = self._rng.uniform(-math.pi, math.pi)
        self.robot.push((speed * math.cos(angle), speed * math.sin(angle)))
        self.messages.append(f"pushed by {speed:.1f} m/s")

    def reset(self) -> None:
        """Put the robot back to the start, without a goal."""
        self.messages.append("put back to the start")
        self._start()

    def hit(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
        """(3,) where a ray meets the terrain in the world, or None [m]."""
        groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        groups[TERRAIN_GROUP] = 1
        model, data = self.robot.model, self.robot.data
        distance = mujoco.mj_ray(model, data, origin, direction, groups, 1, -1, None)
        return origin + distance * direction if distance >= 0.0 else None

    def _start(self) -> None:
        """From here on the controller knows of nothing that was before."""
        self.robot.reset()
        self.controller.reset()
        self.goal: Goal = STOP
        self.command = JointCommand(np.array(self.robot.robot.default_joint_pos), "stop", "")
        self._judged = True

    def _judge(self) -> None:
        """Say once whether the robot was at its target when the time was over."""
        if self._judged or self.target is None or self.time_s < self.target.arrive_at_s - 1e-6:
            return
        arrived = self.distance < self.controller.policy.task.arrival_radius_m
        self.messages.append(f"{'arrived' if arrived else 'not there in time'}: {self.distance:.2f} m from the target")
        self._judged = True

    def _look_after(self) -> None:
        """Put a robot back that cannot go on."""
        if self.robot.fell:
            cause = "fell into a hole"
        elif self.robot.crashed:
            cause = "fell over: its base touched something"
        elif self.robot.left_ground:
            cause = "walked off the edge of the ground"
        else:
            return
        self.falls += 1
        self.messages.append(f"{cause}; put back to the start")
        self._start()

    def _ground_height(self, place: np.ndarray) -> float:
        return float(self.robot.tile.heights[*cell_index(place)])
