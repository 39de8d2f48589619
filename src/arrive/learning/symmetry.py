"""Left-right reflection of observations and actions, with maps derived from names."""

from dataclasses import dataclass

import torch
from tensordict import TensorDict
from torch import Tensor

from arrive.env import POLICY, ArriveEnv
from arrive.task.observations import joint_mirror


@dataclass(frozen=True)
class Mirror:
    """Index and sign of every entry: mirrored = original[:, index] * sign."""

    observation_index: Tensor
    observation_sign: Tensor
    action_index: Tensor
    action_sign: Tensor

    def observation(self, observation: Tensor) -> Tensor:
        """What the mirrored robot would sense, (n, size)."""
        return observation[:, self.observation_index] * self.observation_sign

    def action(self, action: Tensor) -> Tensor:
        """What the mirrored robot would do, (n, joints)."""
        return action[:, self.action_index] * self.action_sign


def make_mirror(env: ArriveEnv) -> Mirror:
    """The environment's mirror maps."""
    observation_index, observation_sign = env.observer.mirror()
    joints = joint_mirror(env.robot)
    maps = (
        observation_index,
        observation_sign,
        torch.tensor([index for index, _ in joints]),
        torch.tensor([sign for _, sign in joints]),
    )
    return Mirror(*(part.to(env.device) for part in maps))


class Augmentation:
    """Doubles a batch by its mirror image; the form in which rsl_rl asks for it."""

    def __init__(self, mirror: Mirror):
        self._mirror = mirror

    def __call__(
        self, env: ArriveEnv, obs: TensorDict | None, actions: Tensor | None
    ) -> tuple[TensorDict | None, Tensor | None]:
        if obs is not None:
            both = torch.cat([obs[POLICY], self._mirror.observation(obs[POLICY])])
            obs = TensorDict({POLICY: both}, batch_size=[len(both)], device=both.device)
        if actions is not None:
            actions = torch.cat([actions, self._mirror.action(actions)])
        return obs, actions
