"""The mean of the last networks, to be saved as the policy in place of the very last one."""

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel


class WeightAverage:
    """Mean of a network's weights over all iterations at first, then over about the last ones, exponentially."""

    def __init__(self, network: nn.Module, iterations: int):
        """Begin with the network as it is.

        Args:
            iterations: time constant; 1 follows the network itself.
        """
        self._network, self._iterations = network, iterations
        self.restart()

    def restart(self) -> None:
        """Forget the past: the mean is the network as it is, and the first iteration after it takes its place."""
        self._average = AveragedModel(self._network, multi_avg_fn=self._blend)

    def take(self) -> None:
        """Take in the network after one more iteration."""
        self._average.update_parameters(self._network)

    @torch.no_grad()
    def _blend(self, means: list[Tensor], news: list[Tensor], taken: Tensor) -> None:
        torch._foreach_lerp_(means, news, 1.0 / min(int(taken) + 1, self._iterations))

    def weights(self) -> dict[str, Tensor]:
        """The mean, as the network's own state."""
        return self._average.module.state_dict()

    def state_dict(self) -> dict[str, Tensor]:
        return self._average.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        self._average.load_state_dict(state)
