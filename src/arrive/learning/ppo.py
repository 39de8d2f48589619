"""Builds rsl_rl's PPO from our configuration."""

import contextlib
import io
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from tensordict import TensorDict

from arrive.config import PPOConfig
from arrive.env import POLICY, ArriveEnv
from arrive.learning.networks import REFLECTED, Network, choose_precision
from arrive.learning.ranks import ALONE, Ranks
from arrive.learning.symmetry import make_reflections

NETWORK_CLASS = "arrive.learning.networks:Network"
DISTRIBUTION_CLASS = "rsl_rl.modules.distribution:GaussianDistribution"


def make_ppo(config: PPOConfig, env: ArriveEnv, observations: TensorDict, ranks: Ranks = ALONE) -> PPO:
    """Build the algorithm with new networks, initialised from torch's global random state."""
    settings = _settings(config, env, ranks)
    if reflections := settings["actor"]["reflections"]:
        observations = observations.clone(recurse=False)
        observations[REFLECTED] = torch.zeros(env.num_envs, len(reflections), device=env.device)
    with contextlib.redirect_stdout(io.StringIO()):  # rsl_rl prints its models
        algorithm = PPO.construct_algorithm(observations, env, settings, str(env.device))
    algorithm.train_mode()
    return algorithm


def make_actor(config: PPOConfig, observations: TensorDict, num_actions: int, reflections: int) -> Network:
    """An actor without critic, to run a trained policy in float32.

    Args:
        reflections: number of symmetries. The state dict brings their maps.
    """
    settings = _network_settings(config) | _noise_settings(config)
    settings |= {"precision": "float32", "reflections": reflections}
    return Network(observations, {"actor": [POLICY]}, "actor", num_actions, **settings).eval()


def _network_settings(config: PPOConfig) -> dict[str, Any]:
    return {
        "hidden_dims": list(config.hidden),
        "activation": "elu",
        "precision": choose_precision(config.precision),
    }


def _noise_settings(config: PPOConfig) -> dict[str, Any]:
    return {
        "distribution_cfg": {"class_name": DISTRIBUTION_CLASS, "init_std": config.init_std, "std_type": "log"},
    }


def _settings(config: PPOConfig, env: ArriveEnv, ranks: Ranks) -> dict[str, Any]:
    network = {"class_name": NETWORK_CLASS} | _network_settings(config)
    network["reflections"] = make_reflections(env) if config.symmetry else ()
    return {
        "num_steps_per_env": config.num_steps,
        "obs_groups": {"actor": [POLICY], "critic": [POLICY]},
        "multi_gpu": ranks.settings(),
        "actor": network | _noise_settings(config),
        "critic": network,
        "algorithm": {
            "class_name": "rsl_rl.algorithms:PPO",
            "num_learning_epochs": config.epochs,
            "num_mini_batches": config.mini_batches,
            "gamma": config.gamma,
            "lam": config.lam,
            "clip_param": config.clip,
            "learning_rate": config.learning_rate,
            "schedule": "adaptive" if config.desired_kl > 0 else "fixed",
            "desired_kl": config.desired_kl or None,
            "entropy_coef": config.entropy,
            "value_loss_coef": config.value_loss,
            "max_grad_norm": config.max_grad_norm,
        },
    }
