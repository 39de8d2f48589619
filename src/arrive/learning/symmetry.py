"""Networks that treat a robot's mirror images alike: a target behind is one ahead, to a robot that is reflected.

The robot looks the same from left and right, and some robots from front and back. What is right for one command is
then right, reflected, for its mirror image. The networks see every observation reflected so that the command leads
forwards and to the left, and what they answer is reflected back. They learn a quarter of the directions, and no
walking direction can be preferred (the paper's section Emergent Gaits regrets that its policies do).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from arrive.env import ArriveEnv
from arrive.task.observations import joint_mirror, joint_reverse


@dataclass(frozen=True)
class Reflection:
    """Index and sign of every entry: reflected = original[:, index] * sign."""

    observation_index: Tensor
    observation_sign: Tensor
    action_index: Tensor
    action_sign: Tensor
    side: int
    """Column of the observation that is negative where the command leads to the far side of the mirror."""

    def observation(self, observation: Tensor) -> Tensor:
        """What the reflected robot would sense, (n, size)."""
        return observation[:, self.observation_index] * self.observation_sign

    def action(self, action: Tensor) -> Tensor:
        """What the reflected robot would do, (n, joints)."""
        return action[:, self.action_index] * self.action_sign


def make_reflections(env: ArriveEnv) -> tuple[Reflection, ...]:
    """Front-back reflection, where the robot has that symmetry, and left-right reflection."""
    observer, robot = env.observer, env.robot
    ahead, left = (observer.column(*side) for side in env.task.sides)
    mirror = _reflection(observer.mirror(), joint_mirror(robot), left)
    if robot.joint_reverse is None:
        return (mirror,)
    return _reflection(observer.reverse(), joint_reverse(robot), ahead), mirror


def _reflection(observation: tuple[Tensor, Tensor], joints: tuple[tuple[int, float], ...], side: int) -> Reflection:
    index, sign = zip(*joints, strict=True)
    return Reflection(*observation, torch.tensor(index), torch.tensor(sign), side)
