"""Networks that learn in bfloat16 where the processor multiplies it faster."""

import torch
from rsl_rl.models import MLPModel
from torch import Tensor, nn

from arrive.config import Precision


class MixedPrecision(nn.Sequential):
    """Layers of which all but the last compute in bfloat16; weights and output stay float32.

    Data are collected with these networks too, so that old and new probabilities of an action are rounded alike.
    """

    def forward(self, x: Tensor) -> Tensor:
        *hidden, last = self
        with torch.autocast(x.device.type, torch.bfloat16):
            for layer in hidden:
                x = layer(x)
        return last(x.float())


class MixedPrecisionModel(MLPModel):
    """rsl_rl's model with the same parameters under the same names, computed by `MixedPrecision`."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.mlp = MixedPrecision(*self.mlp)


def choose_precision(precision: Precision) -> Precision:
    """What `auto` means on this processor: bfloat16 where it has instructions for it."""
    if precision != "auto":
        return precision
    return "bfloat16" if torch.cpu.get_capabilities().get("avx512_bf16", False) else "float32"
