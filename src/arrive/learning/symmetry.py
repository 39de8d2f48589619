"""Front-back symmetry of the networks: a target behind is a target ahead of the reflected robot.

Some robots are symmetric front to back. The right action for a command is then, reflected, also right for the reflected
command. Observations are reflected so that the command points forward, and the networks' actions are reflected back. So
the networks learn only half of the directions, and they cannot prefer one walking direction, as the paper's policies do
(section Emergent Gaits).

Left and right are not treated so, although every robot here has that symmetry: on the way to a target straight ahead,
the command points to the left and to the right in turn at every sway of the body, and robots tripped over the change.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from arrive.env import ArriveEnv
from arrive.task.observations import reverse_map


@dataclass(frozen=True)
class Reflection:
    """Index and sign of every entry: reflected = original[:, index] * sign."""

    observation_index: Tensor
    observation_sign: Tensor
    action_index: Tensor
    action_sign: Tensor
    side: int
    """Column of the observation that is negative if the command points to the far side of the plane of reflection."""

    def observation(self, observation: Tensor) -> Tensor:
        """(n, size) observation of the reflected robot."""
        return observation[:, self.observation_index] * self.observation_sign

    def action(self, action: Tensor) -> Tensor:
        """(n, joints) action of the reflected robot."""
        return action[:, self.action_index] * self.action_sign


def make_reflections(env: ArriveEnv) -> tuple[Reflection, ...]:
    """Front-back reflection if the robot has that symmetry, otherwise none."""
    observer, robot = env.observer, env.robot
    if robot.joint_reverse is None:
        return ()
    return (_reflection(observer.reverse(), reverse_map(robot), observer.column(*env.task.ahead)),)


def _reflection(observation: tuple[Tensor, Tensor], joints: tuple[tuple[int, float], ...], side: int) -> Reflection:
    index, sign = zip(*joints, strict=True)
    return Reflection(*observation, torch.tensor(index), torch.tensor(sign), side)
