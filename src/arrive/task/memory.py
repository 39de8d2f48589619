"""What an environment keeps of its robots between steps."""

from dataclasses import dataclass, fields
from typing import Self

import torch
from torch import Tensor

from arrive.robots.robot import Robot
from arrive.task.feet import follow_feet
from arrive.task.state import State

SAVED = {"inactive": "retired"}
"""Fields whose key in a checkpoint differs."""


@dataclass
class Memory:
    """One row per environment."""

    action: Tensor
    """(n, joints) the last action, in units of the action scale."""
    previous_action: Tensor
    """(n, joints) the action before that."""
    joint_vel: Tensor
    """(n, joints) at the last step [rad/s]."""
    foot_vel: Tensor
    """(n, feet, 3) at the last step, in the world frame [m/s]."""
    foot_air_s: Tensor
    """(n, feet) air time of each foot so far [s]."""
    foot_touched: Tensor
    """(n, feet) bool: in contact at the last step."""
    fresh: Tensor
    """(n,) bool: reset and not stepped since."""
    moved: Tensor
    """(n,) bool: reset or pushed since the state was read."""
    shortened: Tensor
    """(n,) bool: in its first episode of the run, which is shortened."""
    inactive: Tensor
    """(n,) bool: no longer simulated."""
    tile: Tensor
    """(n,) index of the tile that the robot stands on."""
    level: Tensor
    """(n,) terrain level of the episode."""

    @classmethod
    def blank(cls, num_envs: int, robot: Robot, device: torch.device) -> Self:
        """The memory before the first reset."""
        joints, feet = len(robot.joint_names), len(robot.foot_sites)

        def flags(*shape: int) -> Tensor:
            return torch.zeros(*shape, dtype=torch.bool, device=device)

        return cls(
            action=torch.zeros(num_envs, joints, device=device),
            previous_action=torch.zeros(num_envs, joints, device=device),
            joint_vel=torch.zeros(num_envs, joints, device=device),
            foot_vel=torch.zeros(num_envs, feet, 3, device=device),
            foot_air_s=torch.zeros(num_envs, feet, device=device),
            foot_touched=flags(num_envs, feet),
            fresh=~flags(num_envs),
            moved=flags(num_envs),
            shortened=flags(num_envs),
            inactive=flags(num_envs),
            tile=torch.zeros(num_envs, dtype=torch.long, device=device),
            level=torch.zeros(num_envs, dtype=torch.long, device=device),
        )

    def rows(self, ids: Tensor) -> "Memory":
        """A copy of some robots' rows."""
        return Memory(**{name: value[ids] for name, value in vars(self).items()})

    def act(self, actions: Tensor) -> None:
        """Store the actions of a step that begins."""
        self.previous_action.copy_(self.action)
        self.action.copy_(actions)

    def keep(self, state: State, dt: float) -> None:
        """Store what the next step needs for its differences and air times."""
        self.joint_vel.copy_(state.joint_vel)
        self.foot_vel.copy_(state.foot_vel_w)
        touches = state.foot_contacts > 0
        in_air_s, _ = follow_feet(self.foot_air_s, self.foot_touched, touches, dt)
        self.foot_air_s.copy_(in_air_s)
        self.foot_touched.copy_(touches)
        self.fresh.zero_()

    def reset(self, ids: Tensor, joint_vel: Tensor, level: Tensor, tile: Tensor, shortened: bool) -> None:
        """Clear the rows of robots that start an episode at these joint velocities, on these levels and tiles."""
        for value in (self.action, self.previous_action, self.foot_vel, self.foot_air_s, self.foot_touched):
            value[ids] = 0
        self.joint_vel[ids] = joint_vel
        self.level[ids], self.tile[ids] = level, tile
        self.fresh[ids], self.moved[ids] = True, True
        self.shortened[ids] = shortened

    def state_dict(self) -> dict[str, Tensor]:
        """A copy, for an exact resume."""
        return {SAVED.get(name, name): value.clone() for name, value in vars(self).items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Resume exactly."""
        for row in fields(self):
            getattr(self, row.name).copy_(state[SAVED.get(row.name, row.name)])
