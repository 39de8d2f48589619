"""One simulated robot on one tile, without torch. The deployment controller can run on it instead of a real robot."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from arrive.deployment.heights import HeightMap
from arrive.deployment.inputs import Sensors
from arrive.physics.divergence import MAX_SPEED, silence_mujoco
from arrive.physics.motors import motor_network, network_motors
from arrive.physics.world import compile_world, sensor_layout
from arrive.robots import get_robot
from arrive.rotation import heading, matrix
from arrive.terrain.shapes import GROUND_HALF
from arrive.terrain.tile import RASTER_CELL, RASTER_HALF, RASTER_SIZE, Box, Tile

if TYPE_CHECKING:
    from arrive.config import Config

DROP = 0.02
"""Robots of ANYmal C's size start this much above standing height [m]."""
FOOT_MARGIN = 0.05
"""Ground this much farther from a start than the feet's centres can still be under a foot [m]."""
MAP_MARGIN = 0.5
"""The height map reaches this much farther than the policy's outermost grid point, as the robot may have moved when an
older map is used [m]."""
FAR = 200.0
"""Half the edge of ground that is extended beyond its tile [m]."""
TOUCH = 1e-6
"""Tolerance for a block that ends at the edge of the ground [m]."""


def continued(tile: Tile) -> Tile:
    """The tile with the blocks at its edge extended to `FAR`, so that a driven robot does not fall off.

    A tile with a height field, or with a tilted block at its edge, is returned unchanged.
    """
    if tile.height_field is not None:
        return tile
    boxes = tuple(drawn for box in tile.boxes if (drawn := _drawn_out(box)) is not None)
    return replace(tile, boxes=boxes) if len(boxes) == len(tile.boxes) else tile


def _drawn_out(box: Box) -> Box | None:
    """The block, extended if it touches the edge of the ground; None if it is tilted there."""
    center, half = np.array(box.center), np.array(box.half_size)
    turn = matrix(np.array(box.quat))
    for axis in (0, 1):
        reach = float(np.abs(turn[axis]) @ half)
        low, high = center[axis] - reach, center[axis] + reach
        touches = low <= -GROUND_HALF + TOUCH, high >= GROUND_HALF - TOUCH
        if not any(touches):
            continue
        own = int(np.argmax(np.abs(turn[axis])))
        if abs(turn[axis, own]) < 1.0 - 1e-9:
            return None
        low, high = (-FAR if touches[0] else low), (FAR if touches[1] else high)
        center[axis], half[own] = (low + high) / 2, (high - low) / 2
    return replace(box, center=tuple(center.tolist()), half_size=tuple(half.tolist()))


class SimulatedRobot:
    """A robot in MuJoCo with the physics of training, stepped at the policy's rate.

    `model` and `data` are MuJoCo's own, for drawing. After a step, the body poses in `data` are one physics step older
    than `qpos`. Only pictures use them.
    """

    def __init__(
        self,
        config: Config,
        tile: Tile,
        friction: float = 1.0,
        payload_kg: float = 0.0,
        visuals: bool = False,
    ):
        """Compile the world and put the robot at the tile's origin, looking along x.

        Args:
            config: gives the robot, the physics options and the extent of the height map. Its randomisation is not
                used.
            tile: the ground, see `Ground.build`. `continued` removes its edge.
            friction: sliding friction of every contact.
            payload_kg: mass added to the base [kg].
            visuals: whether to add the visual shapes.

        Raises:
            ArriveError: no such robot, or its actuator network cannot be used.
        """
        silence_mujoco()
        self.robot, self.tile = get_robot(config.robot), tile
        self.control_dt = config.physics.control_dt
        """Length of one step [s]."""
        self.model = compile_world(self.robot, tile, config.physics, friction, payload_kg, visuals)
        self.data = mujoco.MjData(self.model)
        self._decimation = config.physics.decimation
        self._motors = network_motors(config.physics, self.robot, 1, motor_network(config.physics))
        self._crash_sensors = sensor_layout(self.robot).crash_contacts
        edges = [abs(box.center[axis]) + box.half_size[axis] for box in tile.boxes for axis in (0, 1)]
        self._reach = tile.height_field.half_extent if tile.height_field is not None else max(edges)
        self._map_half = config.observation.heights.reach_m + MAP_MARGIN
        self._feet_radius = float(np.hypot(*self.robot.foot_corners().T).max())
        self.reset()

    def reset(self, position: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0) -> None:
        """Stand the robot still at its default pose, over the highest ground that a foot can reach at any heading.

        Args:
            position: horizontal position of the base in the tile's frame [m].
            yaw: heading [rad].
        """
        mujoco.mj_resetData(self.model, self.data)
        qpos = self.data.qpos
        qpos[:3] = *position, self._highest(position) + self.robot.standing_height + DROP * self.robot.size
        qpos[3:7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
        qpos[7:] = self.robot.default_joint_pos
        if self._motors is None:
            self.data.ctrl[:] = qpos[7:]
        else:
            self._motors.reset(np.zeros(1, dtype=int))
        # Only for pictures. `mj_forward` would leave a solver warm start that training does not have.
        mujoco.mj_kinematics(self.model, self.data)
        self._failed = False

    def step(self, joint_targets: np.ndarray) -> None:
        """Advance one policy step (20 ms by default) towards (joints,) joint targets [rad]."""
        try:
            if self._motors is None:
                self.data.ctrl[:] = joint_targets
                mujoco.mj_step(self.model, self.data, self._decimation)
                return
            for _ in range(self._decimation):
                torque = self._motors.torque(joint_targets[None], self.data.qpos[None, 7:], self.data.qvel[None, 6:])
                self.data.ctrl[:] = torque[0]
                mujoco.mj_step(self.model, self.data)
        except mujoco.FatalError:
            self._failed = True

    def push(self, velocity: tuple[float, float]) -> None:
        """Add this to the base's horizontal velocity, in the world frame [m/s]."""
        self.data.qvel[:2] += velocity

    @property
    def time_s(self) -> float:
        """Time since the last reset [s]."""
        return self.data.time

    @property
    def base_pos_w(self) -> np.ndarray:
        """(3,) [m]."""
        return self.data.qpos[:3].copy()

    @property
    def base_lin_vel_w(self) -> np.ndarray:
        """(3,) [m/s]."""
        return self.data.qvel[:3].copy()

    @property
    def yaw(self) -> float:
        """Heading [rad]."""
        return heading(self.data.qpos[3:7])

    @property
    def crashed(self) -> bool:
        """Whether a crash body touched something or the simulation diverged (as in `ArriveEnv`)."""
        touched = bool(self.data.sensordata[self._crash_sensors].any())
        fast = not bool(np.abs(self.data.qvel).max() < MAX_SPEED)
        return touched or fast or self._failed or not bool(np.isfinite(self.data.qpos).all())

    @property
    def fell(self) -> bool:
        """Whether the base is below the tile's fall height (as in `ArriveEnv`)."""
        return bool(self.data.qpos[2] < self.tile.fall_height)

    @property
    def left_ground(self) -> bool:
        """Whether the base is beyond the edge of the ground."""
        return bool(np.abs(self.data.qpos[:2]).max() > self._reach)

    def sensors(self, now_s: float | None = None) -> Sensors:
        """Measurements of a robot with perfect sensors, for `Controller.step`.

        Args:
            now_s: time on the controller's clock; default `time_s` [s].
        """
        qpos, qvel = self.data.qpos, self.data.qvel
        return Sensors(
            joint_pos=qpos[7:].copy(),
            joint_vel=qvel[6:].copy(),
            base_pos_w=qpos[:3].copy(),
            base_quat_w=qpos[3:7].copy(),
            base_lin_vel_b=qvel[:3] @ matrix(qpos[3:7]),
            base_ang_vel_b=qvel[3:6].copy(),
            time_s=self.time_s if now_s is None else now_s,
        )

    def height_map(self, now_s: float | None = None) -> HeightMap:
        """The tile's raster around the robot, for `Controller.step`. Outside the raster, its edge values continue."""
        origin, heights = self._around(self.data.qpos[:2], self._map_half)
        return HeightMap(origin, RASTER_CELL, heights, self.time_s if now_s is None else now_s)

    def _highest(self, position: tuple[float, float]) -> float:
        """Height of the highest ground within the circle of the standing robot's feet [m]."""
        radius = self._feet_radius + FOOT_MARGIN
        corner, heights = self._around(position, radius)
        x, y = (
            (corner[axis] - position[axis]) + RASTER_CELL * (np.arange(heights.shape[axis]) + 0.5) for axis in (0, 1)
        )
        return float(heights[np.hypot(x[:, None], y) < radius].max())

    def _around(self, position: np.ndarray | tuple[float, float], half: float) -> tuple[np.ndarray, np.ndarray]:
        """Outer corner of the first cell, and heights of the cells in the square around a position [m]."""
        first = np.floor((np.nan_to_num(position) - half + RASTER_HALF) / RASTER_CELL).astype(int)
        cells = first[:, None] + np.arange(round(2 * half / RASTER_CELL) + 1)
        x, y = np.clip(cells, 0, RASTER_SIZE - 1)
        return first * RASTER_CELL - RASTER_HALF, self.tile.heights[np.ix_(x, y)]
