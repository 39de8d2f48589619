"""Mirror symmetry of the networks: for a front-back reflected robot, a target behind is a target ahead.

Robots are symmetric left to right, and some also front to back. The right action for a command is then, reflected, also
right for the reflected command. Observations are reflected so that the command points forward and to the left, and the
networks' actions are reflected back. With both symmetries the networks learn only a quarter of the directions, and they
cannot prefer one walking direction, as the paper's policies do (section Emergent Gaits).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from arrive.env import ArriveEnv
from arrive.task.observations import mirror_map, reverse_map


@dataclass(frozen=True)
class Reflection:
    """Index and sign of every entry: reflected = original[:, index] * sign."""

    observation_index: Tensor
    observation_sign: Tensor
    action_index: Tensor
    action_sign: Tensor
    side: int
    """Column of the observation that is negative if the command points to the far side of the mirror plane."""

    def observation(self, observation: Tensor) -> Tensor:
        """(n, size) observation of the reflected robot."""
        return observation[:, self.observation_index] * self.observation_sign

    def action(self, action: Tensor) -> Tensor:
        """(n, joints) action of the reflected robot."""
        return action[:, self.action_index] * self.action_sign


def make_reflections(env: ArriveEnv) -> tuple[Reflection, ...]:
    """Front-back reflection, if the robot has that symmetry, and left-right reflection."""
    observer, robot = env.observer, env.robot
    ahead, left = (observer.column(*side) for side in env.task.sides)
    mirror = _reflection(observer.mirror(), mirror_map(robot), left)
    if robot.joint_reverse is None:
        return (mirror,)
    return _reflection(observer.reverse(), reverse_map(robot), ahead), mirror


def _reflection(observation: tuple[Tensor, Tensor], joints: tuple[tuple[int, float], ...], side: int) -> Reflection:
    index, sign = zip(*joints, strict=True)
    return Reflection(*observation, torch.tensor(index), torch.tensor(sign), side)
