"""A trained policy, loaded from a file."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from arrive.config import Config
from arrive.env import POLICY, ArriveEnv
from arrive.errors import ArriveError
from arrive.learning.checkpoint import Origin, check_schema, load_policy_file
from arrive.learning.networks import Network
from arrive.learning.ppo import make_actor
from arrive.learning.rundir import recorded_commit, require_imports, with_own_motor
from arrive.policies import POLICY_NAME, find_policy, results_folder

CPU = torch.device("cpu")
LOG_STD = "distribution.log_std_param"
"""Name of the parameter with one entry per action."""


@dataclass(frozen=True)
class Policy:
    """The mean action of a trained network, and its origin."""

    path: Path
    config: Config
    schema: list[dict[str, Any]]
    commit: str
    samples: int
    actor: Network
    device: torch.device = CPU
    """Device of the network."""

    @property
    def folder(self) -> Path:
        """Folder of its results."""
        return results_folder(self.path)

    @property
    def name(self) -> str:
        """Name of the policy, which is its folder's name."""
        return self.folder.resolve().name

    @torch.inference_mode()
    def act(self, observation: Tensor) -> Tensor:
        """(n, joints) actions for (n, size) scaled observations, without exploration noise."""
        return self.actor(TensorDict({POLICY: observation}, batch_size=[len(observation)]))

    def check(self, env: ArriveEnv) -> None:
        """Check that the environment has the robot and observation that this policy was trained on.

        Raises:
            ArriveError: it has another robot or observation.
        """
        if self.config.robot != env.config.robot:
            raise ArriveError(f"{self.path} was trained for the robot {self.config.robot!r}, not {env.config.robot!r}")
        check_schema(self.schema, env.observer.schema(), self.path)


def load_policy(path: Path, device: torch.device | str = "cpu") -> Policy:
    """Read a policy. Nothing in its file is executed. Its commit is the one in the run's record, where there is one.

    Args:
        path: a run folder, a policy.pt, or the name of a shipped policy.
        device: device of the network, and of the environments in which it is evaluated.

    Raises:
        ArriveError: the file is missing, damaged or not from arrive, or its networks do not fit its configuration.
    """
    path = find_policy(path)
    path = path / POLICY_NAME if path.is_dir() else path
    require_imports(path.parent)
    origin, weights = load_policy_file(path)
    origin = replace(origin, commit=recorded_commit(path.parent) or origin.commit)
    return build_policy(origin, weights, path, device)


def build_policy(origin: Origin, weights: dict[str, Tensor], path: Path, device: torch.device | str) -> Policy:
    """Make a policy from an actor's weights.

    Raises:
        ArriveError: the weights do not fit the configuration.
    """
    actor = _make_actor(origin, weights, path).to(device)
    config = with_own_motor(origin.config, path.parent)
    return Policy(path, config, origin.schema, origin.commit, origin.samples, actor, torch.device(device))


def _make_actor(origin: Origin, weights: dict[str, Tensor], path: Path) -> Network:
    if LOG_STD not in weights:
        raise ArriveError(f"the networks in {path} do not fit its configuration: there is no {LOG_STD}")
    sample = TensorDict({POLICY: torch.zeros(1, origin.schema[-1]["stop"])}, batch_size=[1])
    try:
        reflections = len(weights.get("facing.side", ()))
        actor = make_actor(origin.config.ppo, sample, len(weights[LOG_STD]), reflections)
        actor.load_state_dict(weights)
    except (RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[-1].strip()
        raise ArriveError(f"the networks in {path} do not fit its configuration: {reason}") from error
    return actor
