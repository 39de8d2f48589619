"""rsl_rl's PPO behind our own configuration."""

import contextlib
import io

from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from arrive.config import PPOConfig
from arrive.env import POLICY, ArriveEnv
from arrive.learning.networks import choose_precision
from arrive.learning.ranks import ALONE, Ranks
from arrive.learning.symmetry import Augmentation, make_mirror

MODEL_CLASSES = {
    "float32": "rsl_rl.models:MLPModel",
    "bfloat16": "arrive.learning.networks:MixedPrecisionModel",
}
DISTRIBUTION_CLASS = "rsl_rl.modules.distribution:GaussianDistribution"


def make_ppo(config: PPOConfig, env: ArriveEnv, observations: TensorDict, ranks: Ranks = ALONE) -> PPO:
    """Build the algorithm with fresh networks, drawn from torch's global random state."""
    with contextlib.redirect_stdout(io.StringIO()):  # rsl_rl prints its models
        algorithm = PPO.construct_algorithm(observations, env, _settings(config, env, ranks), str(env.device))
    algorithm.train_mode()
    return algorithm


def make_actor(config: PPOConfig, observations: TensorDict, num_actions: int) -> MLPModel:
    """An actor alone, to run a trained policy."""
    settings = _actor_settings(config)
    settings.pop("class_name")
    return MLPModel(observations, {"actor": [POLICY]}, "actor", num_actions, **settings).eval()


def _actor_settings(config: PPOConfig) -> dict:
    return {
        "class_name": MODEL_CLASSES[choose_precision(config.precision)],
        "hidden_dims": list(config.hidden),
        "activation": "elu",
        "distribution_cfg": {"class_name": DISTRIBUTION_CLASS, "init_std": config.init_std, "std_type": "log"},
    }


def _settings(config: PPOConfig, env: ArriveEnv, ranks: Ranks) -> dict:
    augmentation = {"data_augmentation_func": Augmentation(make_mirror(env)), "use_data_augmentation": True}
    return {
        "num_steps_per_env": config.num_steps,
        "obs_groups": {"actor": [POLICY], "critic": [POLICY]},
        "multi_gpu": ranks.settings(),
        "actor": _actor_settings(config),
        "critic": {
            "class_name": MODEL_CLASSES[choose_precision(config.precision)],
            "hidden_dims": list(config.hidden),
            "activation": "elu",
        },
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
            "symmetry_cfg": augmentation if config.symmetry else None,
        },
    }
