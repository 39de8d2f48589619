"""Randomisation: start states and pushes."""

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from arrive.fields import Interval, NotNegative, Positive, Range, Share
from arrive.robots.robot import Robot
from arrive.task.rotation import quat_of_yaw

SPAWN_CLEARANCE = 0.06
"""Robots of ANYmal C's size start this much above standing height, because a random pose may stretch their legs [m]."""


@dataclass(frozen=True)
class RandomisationConfig:
    """What differs between robots and what disturbs them."""

    friction: Annotated[Interval, Range(0.0, above=True)] = (0.75, 1.125)
    """Sliding friction of a contact, uniform. legged_gym gives robots 0.5 to 1.25, and PhysX averages that with the
    terrain's 1.0."""
    payload_kg: Interval = (-5.0, 5.0)
    """Mass added to the base, uniform [kg]."""
    push_speed: NotNegative = 1.0
    """Largest sudden change of the base's horizontal velocity per axis [m/s]; 0 for no pushes."""
    push_interval_s: Positive = 15.0
    """Mean time between pushes of one robot [s]."""
    start_yaw_rad: Annotated[float, Range(0.0, math.pi)] = math.pi
    """Start heading, uniform within +- this of the tile's x axis [rad]."""
    start_offset: NotNegative = 0.2
    """Start position, uniform within +- this of the tile's origin, per axis [m]."""
    start_speed: NotNegative = 0.5
    """Start velocity of the base, uniform within +- this, per axis [m/s and rad/s]."""
    start_joint_scale: Share = 0.5
    """Start joint positions: the default ones times a factor that is uniform within 1 +- this."""


def start_states(
    n: int, robot: Robot, config: RandomisationConfig, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw random poses and velocities around standing at the tile's origin.

    Returns:
        (n, 7 + joints) positions and (n, 6 + joints) velocities in MuJoCo's order [m, rad, m/s, rad/s], float64.
    """
    joints, device = len(robot.joint_names), generator.device

    def signed(*shape: int) -> Tensor:
        return 2.0 * torch.rand(*shape, generator=generator, device=device) - 1.0

    position = torch.zeros(n, 3, device=device)
    position[:, :2] = config.start_offset * signed(n, 2)
    position[:, 2] = robot.standing_height + SPAWN_CLEARANCE * robot.size
    quat = quat_of_yaw(config.start_yaw_rad * signed(n))
    default = torch.tensor(robot.default_joint_pos, device=device)
    joint_pos = default * (1.0 + config.start_joint_scale * signed(n, joints))
    velocity = torch.zeros(n, 6 + joints, device=device)
    velocity[:, :6] = config.start_speed * signed(n, 6)
    return torch.cat([position, quat, joint_pos], dim=-1).double(), velocity.double()


def draw_pushes(
    spared: Tensor, config: RandomisationConfig, control_dt: float, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw the robots to push in this step, each every `push_interval_s` on average, and their changes of velocity.

    Args:
        spared: (num_envs,) bool: robots not to push.

    Returns:
        (n,) robots, and (n, 3) changes of their base velocities in the world frame [m/s], float64.
    """
    device = spared.device
    if config.push_speed <= 0.0:
        return torch.zeros(0, dtype=torch.long, device=device), torch.zeros(0, 3, dtype=torch.double, device=device)
    drawn = torch.rand(len(spared), generator=generator, device=device) < control_dt / config.push_interval_s
    ids = (drawn & ~spared).nonzero().squeeze(-1)
    velocity = torch.zeros(len(ids), 3, dtype=torch.double, device=device)
    if len(ids):
        velocity[:, :2] = config.push_speed * (2.0 * torch.rand(len(ids), 2, generator=generator, device=device) - 1.0)
    return ids, velocity
