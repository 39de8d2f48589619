"""How a policy moves: torque, action rate, limits, legs that cross, and whether it stands at the end."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from arrive.env import ArriveEnv
from arrive.evaluation.legs import LegCrossing
from arrive.task.state import State

AT_LIMIT = 0.99
"""A torque of at least this share of the effort limit counts as being at it."""
NEAR_LIMIT_RAD = 0.05
"""A joint nearer than this to an end of its range counts as being at it [rad]."""
REST_S = 1.0
"""The last second of an episode that lasts to its end is looked at as rest [s]."""
LOOK_S = 0.1
"""Whether legs cross is looked at this often [s]."""
ALL_THE_TIME = ("torque_nm", "action_rate_rad_s", "at_torque_limit", "at_joint_limit")
AT_REST = ("rest_joint_speed_rad_s", "rest_height")
UNITS = {
    "torque_nm": "mean torque of a joint [N m]",
    "action_rate_rad_s": "mean rate of a joint's target [rad/s]",
    "at_torque_limit": "share of joints at their effort limit",
    "at_joint_limit": "share of joints at an end of their range",
    "legs_crossed": "share of the time in which two legs touch, or overlap without `physics.leg_contacts`",
    "rest_joint_speed_rad_s": "mean joint speed in the last second [rad/s]",
    "rest_height": "base height in the last second, over that of standing",
}
"""The meaning of each figure."""


class MotionMeter:
    """Sums up each robot's figures over its first episode."""

    def __init__(self, env: ArriveEnv):
        """Start with nothing seen."""
        robot = env.robot
        ranges = np.array([robot.model.joint(name).range for name in robot.joint_names], dtype=np.float32)
        self._range = torch.from_numpy(ranges).to(env.device)
        self._effort_limit = torch.tensor([motor.effort_limit for motor in robot.motors], device=env.device)
        self._rate = robot.action_scale / env.control_dt
        self._standing_height = robot.standing_height
        self._rest_from = env.max_episode_length - round(REST_S / env.control_dt)
        self._look_every = max(round(LOOK_S / env.control_dt), 1)
        self._legs = LegCrossing(robot)
        self._sums = {name: torch.zeros(env.num_envs) for name in UNITS}
        self._seen = {name: torch.zeros(env.num_envs) for name in UNITS}

    def take(self, state: State, waiting: Tensor, step: int) -> None:
        """Take in one policy step.

        Args:
            waiting: (num_envs,) bool, robots whose first episode goes on.
            step: policy steps since its start.
        """
        resting, looking = step > self._rest_from, step % self._look_every == 0
        for name in ALL_THE_TIME + AT_REST * resting:
            self._add(name, waiting, torch.where(waiting, getattr(self, f"_{name}")(state).cpu(), 0.0))
        if looking:
            crossed = torch.zeros(len(waiting))
            crossed[waiting] = torch.from_numpy(self._legs.found(state.joint_pos.cpu()[waiting].numpy())).float()
            self._add("legs_crossed", waiting, crossed)

    def _add(self, name: str, waiting: Tensor, values: Tensor) -> None:
        self._sums[name] += values
        self._seen[name] += waiting

    def means(self) -> dict[str, Tensor]:
        """(num_envs,) each figure's mean; NaN where there was nothing to see."""
        return {name: total / self._seen[name] for name, total in self._sums.items()}

    def _torque_nm(self, state: State) -> Tensor:
        return state.joint_torque.abs().mean(-1)

    def _action_rate_rad_s(self, state: State) -> Tensor:
        return (state.action - state.previous_action).abs().mean(-1) * self._rate

    def _at_torque_limit(self, state: State) -> Tensor:
        return (state.joint_torque.abs() >= AT_LIMIT * self._effort_limit).float().mean(-1)

    def _at_joint_limit(self, state: State) -> Tensor:
        low, high = self._range.T
        room = torch.minimum(state.joint_pos - low, high - state.joint_pos)
        return (room < NEAR_LIMIT_RAD).float().mean(-1)

    def _rest_joint_speed_rad_s(self, state: State) -> Tensor:
        return state.joint_vel.abs().mean(-1)

    def _rest_height(self, state: State) -> Tensor:
        ground = state.heights_w.median(-1).values
        return (state.base_pos_w[:, 2] - ground) / self._standing_height


def summary(motion: dict[str, Tensor], chosen: Tensor) -> dict[str, Any]:
    """Means over the chosen episodes, (n,) bool, as JSON data; None where none of them had anything to see."""
    means = {name: float(values[chosen].nanmean()) for name, values in motion.items()}
    return {name: round(mean, 5) if np.isfinite(mean) else None for name, mean in means.items()}
