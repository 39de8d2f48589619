"""Short trainings of a few robots, and comparisons of two of them."""

import csv

import torch
from torch import Tensor

from arrive import cli
from arrive.build import build_env
from arrive.config import override
from arrive.learning.trainer import Budget, Trainer
from arrive.presets import get_preset

NUM_ENVS = 16
STEPS = 8
SMALL = (
    "task.episode_s=0.4",  # 20 policy steps, so that episodes end and levels change
    "task.episode_min_s=0.4",
    "task.reward_window_s=0.2",
    "ppo.hidden=[16]",
    f"ppo.num_steps={STEPS}",
    "ppo.mini_batches=2",
    "ppo.epochs=2",
    "terrain.levels=3",
    "terrain.variants=2",
    "randomisation.push_interval_s=0.5",
)
TIME_COLUMNS = {"progress/elapsed_s", "progress/samples_per_s"}


def arguments(terrain: str, *rest: object) -> list[str]:
    """A command line that trains a few small robots."""
    fixed = ["train", terrain, "--preset", "paper", "--threads", "1"]
    return [*fixed, *map(str, rest)]


def train(terrain: str, folder, iterations: int, *settings: str, num_envs: int = NUM_ENVS, seed: int = 1) -> dict:
    """Train a new run by the command line and return its checkpoint's state."""
    options = ("--num-envs", num_envs, "--seed", seed, "--iterations", iterations, "--out", folder)
    cli.main(arguments(terrain, *options, "--set", *SMALL, *settings))
    return saved_state(folder)


def make_trainer(folder, *settings: str, terrain: str = '["flat"]') -> Trainer:
    changes = (f"num_envs={NUM_ENVS}", f"terrain.families={terrain}", *SMALL, *settings)
    config = override(get_preset("paper"), changes)
    folder.mkdir(exist_ok=True)
    return Trainer(config, build_env(config, threads=1), folder)


def run(trainer: Trainer, iterations: int, **options) -> list[int]:
    """Train and return the iterations that were reported."""
    reported: list[int] = []
    trainer.train(Budget(iterations=iterations), lambda report: reported.append(report.iteration), **options)
    return reported


def saved_state(folder) -> dict:
    return torch.load(folder / "checkpoint.pt", weights_only=True)["state"]


def leaves(value, path: str = "") -> dict:
    """Every number and tensor of a nested state by its path."""
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list | tuple):
        items = enumerate(value)
    else:
        return {path: value}
    return {name: leaf for key, item in items for name, leaf in leaves(item, f"{path}/{key}").items()}


def differing(first: dict, second: dict) -> list[str]:
    """Paths at which two checkpoint states are not the same to the last bit; the clock is left out."""
    a, b = leaves(first), leaves(second)
    names = (a.keys() | b.keys()) - {"/elapsed_s"}
    return sorted(name for name in names if name not in a or name not in b or not same(a[name], b[name]))


def same(a, b) -> bool:
    if not isinstance(a, Tensor):
        return a == b
    return a.dtype == b.dtype and a.shape == b.shape and a.numpy().tobytes() == b.numpy().tobytes()


def log_rows(folder) -> list[dict[str, str]]:
    with (folder / "log.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k not in TIME_COLUMNS} for row in csv.DictReader(file)]
