"""A new run that begins with the networks and terrain levels of another one."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from arrive.config import Config, TerrainConfig
from arrive.errors import ArriveError
from arrive.learning.checkpoint import check_fits, load_checkpoint
from arrive.learning.state import TrainingState
from arrive.task.curriculum import deal_families


def warm_start(state: TrainingState, config: Config, path: Path) -> int:
    """Take networks and optimiser from another run's checkpoint, and the levels of the families that both have.

    Returns:
        Policy steps that the other run has made.

    Raises:
        ArriveError: no readable checkpoint, or one of another robot, observation or size of networks.
    """
    origin, saved = load_checkpoint(path)
    check_fits(origin, config.robot, state.env.observer.schema(), path)
    try:
        state.algorithm.load(saved["algorithm"], None, True)
        levels = reached_levels(saved, origin.config.terrain)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ArriveError(f"the networks in {path} do not fit: choose the same ppo.hidden. ({error})") from error
    state.env.settle(levels)
    state.observations = state.env.get_observations()
    return origin.samples


def reached_levels(saved: dict[str, Any], terrain: TerrainConfig) -> dict[str, Tensor]:
    """Levels of a checkpoint's robots by terrain family, 0 for the easiest to 1 for the hardest."""
    parts = [part["env"]["levels"] for part in (saved, *saved["others"])]
    levels = torch.cat(parts) / max(terrain.levels - 1, 1)
    family = torch.cat([deal_families(len(part), len(terrain.families)) for part in parts])
    return {name: levels[family == index] for index, name in enumerate(terrain.families)}
