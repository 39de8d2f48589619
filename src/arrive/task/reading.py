"""Turns readings from physics into the state that observations, rewards and terminations use."""

import torch
from torch import Tensor

from arrive.kinematics import FootKinematics
from arrive.physics.engine import Readings
from arrive.robots.legs import foot_chains
from arrive.robots.robot import Robot
from arrive.task.feet import follow_feet
from arrive.task.heights import HeightGrid, HeightsConfig, grid_heights
from arrive.task.memory import Memory
from arrive.task.rotation import rotate_inverse, yaw_of
from arrive.task.state import State
from arrive.terrain.rasters import Rasters


class Reader:
    """Computes the robots' state from their readings."""

    def __init__(self, robot: Robot, rasters: Rasters, heights: HeightsConfig, control_dt: float):
        self._rasters, self._dt = rasters, control_dt
        device = rasters.heights.device
        self._grid = HeightGrid(heights).points.to(device)
        self._kinematics = FootKinematics(
            foot_chains(robot), robot.joint_names, lambda table: torch.tensor(table, dtype=torch.float32, device=device)
        )
        self._default_joint_pos = torch.tensor(robot.default_joint_pos, device=device)
        self._down = torch.tensor([0.0, 0.0, -1.0], device=device)

    def read(self, readings: Readings, memory: Memory) -> State:
        """The state of robots, from their readings and their rows of the memory."""
        if not bool(readings.finite.all()):
            readings = _silence(readings)
        quat, moving = readings.base_quat_w, (~memory.fresh).float()
        touches = readings.foot_contacts > 0
        _, landed_s = follow_feet(memory.foot_air_s, memory.foot_touched, touches, self._dt)
        return State(
            base_pos_w=readings.base_pos_w,
            base_quat_w=quat,
            base_lin_vel_w=readings.base_lin_vel_w,
            base_lin_vel_b=rotate_inverse(quat, readings.base_lin_vel_w),
            base_ang_vel_b=readings.base_ang_vel_b,
            gravity_b=rotate_inverse(quat, self._down.expand(len(quat), 3)),
            joint_pos=readings.joint_pos,
            joint_offset=readings.joint_pos - self._default_joint_pos,
            joint_vel=readings.joint_vel,
            joint_acc=(readings.joint_vel - memory.joint_vel) / self._dt,
            joint_torque=readings.joint_torque,
            foot_pos_b=self._kinematics.positions_b(readings.joint_pos.sin(), readings.joint_pos.cos()),
            foot_vel_w=readings.foot_vel_w,
            foot_acc_w=(readings.foot_vel_w - memory.foot_vel) * (moving / self._dt)[:, None, None],
            landed_air_s=landed_s,
            action=memory.action,
            previous_action=memory.previous_action,
            crash_contacts=readings.crash_contacts,
            collision_contacts=readings.collision_contacts,
            foot_contacts=readings.foot_contacts,
            heights_w=self._heights_w(readings.base_pos_w, quat, memory.tile),
            fall_height=self._rasters.fall_height[memory.tile],
            finite=readings.finite,
        )

    def _heights_w(self, base_pos_w: Tensor, quat: Tensor, tile: Tensor) -> Tensor:
        return grid_heights(self._rasters.heights, tile, self._grid, base_pos_w, yaw_of(quat))


def _silence(readings: Readings) -> Readings:
    """Replace the readings of diverged robots by zeros, so that they cannot spoil sums over all robots."""
    values = {}
    for name, value in vars(readings).items():
        mask = readings.finite.view(-1, *[1] * (value.ndim - 1))
        values[name] = value if name == "finite" else torch.where(mask, value, 0.0)
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=readings.finite.device)
    values["base_quat_w"] = torch.where(readings.finite.unsqueeze(-1), values["base_quat_w"], upright)
    return Readings(**values)
