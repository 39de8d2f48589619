"""Reward terms: each a rate per second, so that weight * rate * time step is what a policy step earns.

Rewards are positive; costs are named `*_cost`, are positive too, and get negative weights.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from arrive.config import TaskConfig
from arrive.task.state import Command, State

STALL_SPEED = 0.1
"""A base slower than this is waiting (paper, eq. 4) [m/s]."""
STALL_DISTANCE = 0.5
"""Waiting farther from the target than this is stalling (paper, eq. 4) [m]."""
PACES = (0.3, 1.5)
"""Slowest and fastest speed that the `pace` reward asks for [m/s]."""
LEAST_TIME_S = 0.2
"""Less remaining time than this is taken for this much [s]."""
AIR_TIME_S = 0.5
"""How long a foot should be in the air in one step (legged_gym) [s]."""


def distance_to_target(state: State, command: Command) -> Tensor:
    """(n,) distance between base and target [m]."""
    return (command.target_w - state.base_pos_w).norm(dim=-1)


def in_window(command: Command, window_s: float) -> Tensor:
    """(n,) bool: the task reward is being paid, t > T - T_r (paper, eq. 1)."""
    return command.time_left_s < window_s


def task(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Being at the target during the last T_r seconds: 1/T_r * 1/(1 + |x - x*|^2) (paper, eq. 1).

    Returns:
        (n,) rate [1/s]; its integral over the window is at most 1.
    """
    distance_sq = (command.target_w - state.base_pos_w).square().sum(-1)
    return in_window(command, config.reward_window_s) / (config.reward_window_s * (1.0 + distance_sq))


def task_share(state: State, command: Command, config: TaskConfig) -> tuple[Tensor, Tensor]:
    """(n,) the task reward over its maximum, 1/(1 + |x - x*|^2), and (n,) bool: it is being paid."""
    share = 1.0 / (1.0 + distance_to_target(state, command).square())
    return share, in_window(command, config.reward_window_s)


def exploration(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Cosine between the base's velocity and the direction to the target (paper, eq. 3), (n,) in -1..1."""
    return torch.cosine_similarity(state.base_lin_vel_w, command.target_w - state.base_pos_w, dim=-1)


def stall_cost(state: State, command: Command, config: TaskConfig) -> Tensor:
    """1 while waiting (slower than 0.1 m/s) farther than 0.5 m from the target (paper, eq. 4), (n,)."""
    slow = state.base_lin_vel_w.norm(dim=-1) < STALL_SPEED
    return (slow & (distance_to_target(state, command) > STALL_DISTANCE)).float()


def joint_acc_cost(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Sum of squared joint accelerations (paper, eq. 2), (n,) [rad^2/s^4]."""
    return state.joint_acc.square().sum(-1)


def torque_cost(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Sum of squared joint torques (paper, eq. 2), (n,) [N^2 m^2]."""
    return state.joint_torque.square().sum(-1)


def collision_cost(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Number of thighs and shanks in contact, N_c (paper, eq. 2), (n,)."""
    return state.collision_contacts


def action_rate_cost(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Squared change of the action (paper, eq. 2), (n,) in squared action units."""
    return (state.action - state.previous_action).square().sum(-1)


def foot_acc_cost(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Sum over the feet of their squared acceleration (paper, eq. 2), (n,) [m^2/s^4]."""
    return state.foot_acc_w.square().sum((-2, -1))


def _closing(state: State, command: Command) -> tuple[Tensor, Tensor]:
    """(n,) horizontal speed towards the target [m/s] and (n,) horizontal distance to it [m]."""
    offset = (command.target_w - state.base_pos_w)[:, :2]
    distance = offset.norm(dim=-1)
    return (state.base_lin_vel_w[:, :2] * offset).sum(-1) / distance.clamp(min=1e-6), distance


def approach(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Speed towards the target, up to `approach_speed`; 1 within `approach_radius`. Not in the paper.

    Unlike the cosine of eq. 3 it grows with speed, so that shuffling does not earn what walking does. Where the arrival
    radius is the smaller of the two, that one holds.

    Returns:
        (n,) share of `approach_speed`, at most 1.
    """
    speed, distance = _closing(state, command)
    share = (speed / config.approach_speed).clamp(-1.0, 1.0)
    radius = min(config.approach_radius, config.arrival_radius)
    return torch.where(distance < radius, torch.ones_like(share), share)


def pace(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Speed towards the target over the distance that is left per remaining time. Not in the paper.

    That speed is what a joystick's pseudo velocity asks for. The reward grows up to it and falls again beyond it, so
    that a robot with time to spare earns by taking it.

    Returns:
        (n,) share, -1 to 1; 1 within the arrival radius.
    """
    speed, distance = _closing(state, command)
    share = speed / (distance / command.time_left_s.clamp(min=LEAST_TIME_S)).clamp(*PACES)
    share = torch.where(share > 1.0, (2.0 - share).clamp(min=0.0), share.clamp(min=-1.0))
    return torch.where(distance < config.arrival_radius, torch.ones_like(share), share)


def stand(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Standing still at the target during the reward window. Not in the paper.

    Returns:
        (n,) rate [1/s]: 1/T_r * exp(-2 |v|) within the arrival radius, v the base's velocity; its integral at most 1.
    """
    here = (distance_to_target(state, command) < config.arrival_radius) & in_window(command, config.reward_window_s)
    return here * torch.exp(-2.0 * state.base_lin_vel_w.norm(dim=-1)) / config.reward_window_s


def pose_cost(state: State, command: Command, config: TaskConfig) -> Tensor:
    """Sum of squared joint positions relative to the default pose, (n,) [rad^2]. Not in the paper.

    Without it nothing asks a robot that has stopped to set its feet under its hips again.
    """
    return state.joint_offset.square().sum(-1)


RewardFunction = Callable[[State, Any, TaskConfig], Tensor]
"""Of the state, the task's own command, and the configuration."""

MOTION_COSTS: dict[str, RewardFunction] = {
    "joint_acc_cost": joint_acc_cost,
    "torque_cost": torque_cost,
    "collision_cost": collision_cost,
    "action_rate_cost": action_rate_cost,
    "foot_acc_cost": foot_acc_cost,
    "pose_cost": pose_cost,
}
"""Costs of moving, whatever the command; every task has them."""

REWARDS: dict[str, RewardFunction] = {
    "task": task,
    "exploration": exploration,
    "stall_cost": stall_cost,
    "approach": approach,
    "pace": pace,
    "stand": stand,
} | MOTION_COSTS
"""Terms of the tasks that send robots to places."""
EXPLORATION_REWARDS = ("exploration", "approach", "pace")
"""Terms that lead the way to the target and are removed, or weakened, once it is found."""
CRASH_COST = "crash_cost"
"""Paid once, at a crash, its weight not multiplied by the time step."""
