"""The two architectures in PyTorch, to be trained; their parameters' names are those of `ActuatorNetwork`."""

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional


class LstmModule(nn.Module):
    """LSTM layers and a linear one (legged_gym: two layers of eight units)."""

    def __init__(self, units: int = 8, layers: int = 2):
        super().__init__()
        self.lstm = nn.LSTM(2, units, layers, batch_first=True)
        self.linear = nn.Linear(units, 1)

    def forward(self, inputs: Tensor) -> Tensor:
        """(n, time) scaled torques for (n, time, 2) scaled errors and velocities, from rest."""
        return self.linear(self.lstm(inputs)[0])[..., 0]


class TapsModule(nn.Module):
    """Softsign layers on delayed inputs (Hwangbo et al. 2019: three layers of 32 units)."""

    def __init__(self, tap_steps: Sequence[int], units: Sequence[int] = (32, 32, 32)):
        super().__init__()
        self._tap_steps = tuple(tap_steps)
        sizes = (2 * len(self._tap_steps), *units, 1)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))

    def forward(self, inputs: Tensor) -> Tensor:
        """(n, time) scaled torques for (n, time, 2) scaled errors and velocities, from rest."""
        longest, time = max(self._tap_steps), inputs.shape[1]
        padded = functional.pad(inputs, (0, 0, longest, 0))
        delayed = torch.stack([padded[:, longest - step : longest - step + time] for step in self._tap_steps], dim=-1)
        values = delayed.flatten(-2)  # the errors of all taps, then the velocities
        for layer in self.layers[:-1]:
            values = functional.softsign(layer(values))
        return self.layers[-1](values)[..., 0]
