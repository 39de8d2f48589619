"""A trained policy, ready to act."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor

from arrive.config import Config, from_dict
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.learning.checkpoint import POLICY_NAME, check_schema, load_checked
from arrive.learning.ppo import make_actor
from arrive.policies import find_run

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Policy:
    """The mean action of a trained network, and what the file says about it."""

    path: Path
    config: Config
    schema: list[dict[str, Any]]
    commit: str
    samples: int
    actor: MLPModel
    device: torch.device = CPU
    """Where it acts."""

    @torch.inference_mode()
    def act(self, observation: Tensor) -> Tensor:
        """(n, joints) actions for (n, size) scaled observations, without exploration noise."""
        return self.actor(TensorDict({POLICY: observation}, batch_size=[len(observation)]))

    def check(self, env: ArriveEnv) -> None:
        """Make sure that the environment gives what this policy was trained on.

        Raises:
            ArriveError: another robot or observation.
        """
        if self.config.robot != env.config.robot:
            raise ArriveError(f"{self.path} was trained for the robot {self.config.robot!r}, not {env.config.robot!r}")
        check_schema(self.schema, env.observer.schema(), self.path)


def load_policy(path: Path, device: torch.device | str = "cpu") -> Policy:
    """Read a policy file, or the policy in a run folder; nothing from the file is executed.

    Args:
        path: of the file or the folder, or the name of a folder in `policies/`.
        device: where it acts, and where the environments that it is measured in live.

    Raises:
        ArriveError: missing, truncated, foreign, or its networks do not fit its configuration.
    """
    path = find_run(path)
    path = path / POLICY_NAME if path.is_dir() else path
    content = load_checked(path)
    if "actor" not in content:
        raise ArriveError(f"{path} is a training checkpoint without a policy; use {POLICY_NAME} beside it")
    config = from_dict(Config, content["config"])
    size = content["schema"][-1]["stop"]
    sample = TensorDict({POLICY: torch.zeros(1, size)}, batch_size=[1])
    num_actions = len(content["actor"]["distribution.log_std_param"])
    reflections = len(content["actor"].get("facing.side", ()))
    actor = make_actor(config.ppo, sample, num_actions, reflections)
    try:
        actor.load_state_dict(content["actor"])
    except RuntimeError as error:
        raise ArriveError(f"the networks in {path} do not fit its configuration: {error}") from error
    return Policy(
        path, config, content["schema"], content["commit"], content["samples"], actor.to(device), torch.device(device)
    )
