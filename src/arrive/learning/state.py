"""The state of a training: everything that an exact resume needs, as a snapshot that can be saved and restored."""

import copy
from dataclasses import dataclass, fields
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from tensordict import TensorDict
from torch import Tensor

from arrive.config import Config
from arrive.env import POLICY, ArriveEnv
from arrive.learning.ppo import make_ppo
from arrive.learning.ranks import Ranks
from arrive.learning.statistics import TrainingStatistics

OWN_PARTS = ("env", "observations", "statistics", "random", "random_cuda")
"""The parts of a snapshot that differ between processes."""


@dataclass(frozen=True)
class Snapshot:
    """A training at one moment, as plain data and tensors of its own."""

    iteration: int
    samples: int
    elapsed_s: float
    algorithm: dict[str, Any]
    """Networks and optimiser, as rsl_rl saves them."""
    device: str
    """Kind of device that simulates the robots."""
    env: dict[str, Any]
    observations: Tensor
    """(num_envs, size) the observations for the next action."""
    statistics: dict[str, Any]
    random: Tensor
    random_cuda: Tensor | None

    def own(self) -> dict[str, Any]:
        """The parts that belong to this process alone."""
        return {name: getattr(self, name) for name in OWN_PARTS}


def snapshot_from(state: dict[str, Any]) -> Snapshot:
    """A snapshot from a checkpoint's state.

    Raises:
        KeyError: a part is missing.
    """
    return Snapshot(**{part.name: state[part.name] for part in fields(Snapshot)})


class TrainingState:
    """Networks, optimiser, environment, statistics and random numbers of one training in one process."""

    def __init__(self, config: Config, env: ArriveEnv, ranks: Ranks):
        """Initialise networks from the configuration's seed, equal in all processes. Later random numbers differ."""
        torch.manual_seed(config.seed)
        self.env = env
        self.observations: TensorDict = env.get_observations()
        self.algorithm: PPO = make_ppo(config.ppo, env, self.observations, ranks)
        if not ranks.leads:
            torch.manual_seed(config.seed + ranks.seed_offset)
        self.statistics = TrainingStatistics(env)
        self.iteration, self.samples, self.elapsed_s = 0, 0, 0.0

    def parameters(self) -> dict[str, Tensor]:
        """Every parameter of actor and critic by name."""
        networks = {"actor": self.algorithm.get_policy(), "critic": self.algorithm.critic}
        return {f"{name} {n}": value for name, network in networks.items() for n, value in network.named_parameters()}

    def snapshot(self) -> Snapshot:
        """A snapshot of the training as it is now."""
        cuda = self.env.device.type == "cuda"
        parts = {
            "iteration": self.iteration,
            "samples": self.samples,
            "elapsed_s": self.elapsed_s,
            "algorithm": self.algorithm.save(),
            "device": self.env.device.type,
            "env": self.env.state_dict(),
            "observations": self.observations[POLICY],
            "statistics": self.statistics.state_dict(),
            "random": torch.get_rng_state(),
            "random_cuda": torch.cuda.get_rng_state(self.env.device) if cuda else None,
        }
        return Snapshot(**copy.deepcopy(parts))

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot exactly. The same snapshot can be restored again.

        Raises:
            KeyError, RuntimeError: the snapshot is from another version or configuration.
        """
        self.iteration, self.samples, self.elapsed_s = snapshot.iteration, snapshot.samples, snapshot.elapsed_s
        self.algorithm.load(copy.deepcopy(snapshot.algorithm), None, True)
        self.env.load_state_dict(snapshot.env)
        observations = snapshot.observations.to(self.env.device, copy=True)
        self.observations = TensorDict({POLICY: observations}, batch_size=[self.env.num_envs])
        self.statistics.load_state_dict(copy.deepcopy(snapshot.statistics))
        torch.set_rng_state(snapshot.random)
        if snapshot.random_cuda is not None:
            torch.cuda.set_rng_state(snapshot.random_cuda, self.env.device)
