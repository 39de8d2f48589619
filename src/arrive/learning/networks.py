"""The networks of actor and critic: rsl_rl's, with the configured precision and symmetry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor, nn

from arrive.config import Precision
from arrive.env import POLICY

if TYPE_CHECKING:
    from arrive.learning.symmetry import Reflection


REFLECTED = "reflected"
"""Observation group (n, reflections): 1 where a reflection was already applied to the group that the networks read."""


class MixedPrecision(nn.Sequential):
    """Layers that compute in bfloat16, except the last one. Weights and output stay float32.

    Rollouts use these networks too, so that the old and new probability of an action are rounded in the same way.
    """

    def forward(self, x: Tensor) -> Tensor:
        *hidden, last = self
        with torch.autocast(x.device.type, torch.bfloat16):
            for layer in hidden:
                x = layer(x)
        return last(x.float())


class Facing(nn.Module):
    """Reflects observations so that the command points forward, and reflects the actions back."""

    observation_index: Tensor
    observation_sign: Tensor
    action_index: Tensor
    action_sign: Tensor
    side: Tensor

    def __init__(self, count: int, observation_size: int, num_actions: int):
        """Allocate the maps of this many reflections. `set` or a state dict fills them."""
        super().__init__()
        for name, size in (("observation", observation_size), ("action", num_actions)):
            self.register_buffer(f"{name}_index", torch.zeros(count, size, dtype=torch.long))
            self.register_buffer(f"{name}_sign", torch.ones(count, size))
        self.register_buffer("side", torch.zeros(count, dtype=torch.long))

    def set(self, reflections: Sequence[Reflection]) -> None:
        """Set the maps from reflections."""
        for row, reflection in enumerate(reflections):
            for name, buffer in self.named_buffers():
                buffer[row] = torch.as_tensor(getattr(reflection, name))

    def observation(self, observation: Tensor) -> tuple[Tensor, list[Tensor]]:
        """The reflected (n, size) observation, and for each reflection (n, 1) bool: it was applied.

        It works on the transpose, where an entry of all observations is one row that is copied as a whole. That is
        several times as fast on a CPU as choosing columns.
        """
        entries, needed = observation.t().contiguous(), []
        for row in range(len(self.side)):
            needed.append(entries[self.side[row]] < 0.0)
            reflected = entries.index_select(0, self.observation_index[row]) * self.observation_sign[row].unsqueeze(-1)
            entries = torch.where(needed[-1], reflected, entries)
        return entries.t().contiguous(), [flags.unsqueeze(-1) for flags in needed]

    def action(self, action: Tensor, needed: list[Tensor]) -> Tensor:
        """The (n, joints) action reflected back, which is the same reflection again."""
        for row in reversed(range(len(needed))):
            reflected = action[:, self.action_index[row]] * self.action_sign[row]
            action = torch.where(needed[row], reflected, action)
        return action


class Network(MLPModel):
    """rsl_rl's model with precision and symmetry. Parameters keep rsl_rl's names."""

    mlp: nn.Sequential

    def __init__(
        self,
        *args: Any,
        precision: Precision = "float32",
        reflections: Sequence[Reflection] | int = 0,
        **kwargs: Any,
    ):
        """Build rsl_rl's model.

        Args:
            precision: arithmetic of the hidden layers.
            reflections: maps of the robot's symmetries, or their number if a state dict will fill them; empty or 0 for
                a network without symmetry.
        """
        super().__init__(*args, **kwargs)
        if precision == "bfloat16":
            self.mlp = MixedPrecision(*self.mlp)
        self.facing: Facing | None = None
        if isinstance(reflections, int):
            if reflections:
                last = self.mlp[-1]
                assert isinstance(last, nn.Linear)
                self.facing = Facing(reflections, self.obs_dim, last.out_features)
        elif reflections:
            self.facing = Facing(len(reflections), self.obs_dim, len(reflections[0].action_sign))
            self.facing.set(reflections)

    def reflect_once(self, obs: TensorDict) -> TensorDict:
        """The observations after reflection, so that learning does not reflect them in every pass over a batch.

        Doing it in every pass took a sixth of the training time on a CPU. Without symmetry, nothing changes.
        """
        if self.facing is None:
            return obs
        observation, needed = self.facing.observation(obs[POLICY])
        groups = {POLICY: observation, REFLECTED: torch.cat(needed, -1).float()}
        return TensorDict(groups, batch_size=obs.batch_size, device=obs.device)

    def forward(
        self,
        obs: TensorDict,
        masks: Tensor | None = None,
        hidden_state: None = None,
        stochastic_output: bool = False,
    ) -> Tensor:
        """Values, or actions: sampled if `stochastic_output` is set, otherwise their means.

        Args:
            obs: as the environment gives them, or from `reflect_once`.
        """
        latent = self.get_latent(obs)
        if self.facing is None:
            output = self.mlp(latent)
        else:
            if REFLECTED in obs:
                needed = list((obs[REFLECTED] > 0.0).split(1, -1))
            else:
                latent, needed = self.facing.observation(latent)
            output = self.mlp(latent)
            if self.distribution is not None:  # a value is the same for both robots
                output = self.facing.action(output, needed)
        if self.distribution is None:
            return output
        if stochastic_output:
            self.distribution.update(output)
            return self.distribution.sample()
        return self.distribution.deterministic_output(output)


def choose_precision(precision: Precision) -> Precision:
    """Resolve `auto`: bfloat16 on processors with instructions for it, otherwise float32."""
    if precision != "auto":
        return precision
    return "bfloat16" if torch.cpu.get_capabilities().get("avx512_bf16", False) else "float32"
