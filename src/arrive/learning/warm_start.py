"""Starts a new run from the networks and terrain levels of another one."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from arrive.config import Config, TerrainConfig
from arrive.errors import ArriveError
from arrive.learning.checkpoint import check_fits, load_checkpoint
from arrive.learning.policy import Policy
from arrive.learning.state import TrainingState
from arrive.task.curriculum import assign_families


def warm_start(state: TrainingState, config: Config, start: Path | Policy) -> int:
    """Start from another run's checkpoint or from a policy.

    A checkpoint gives networks, action noise and optimiser, and the levels of the terrain families that both runs have.
    A policy gives only its actor: the critic is new, and robots start on the first level. An exported file does not
    contain the action noise.

    Args:
        start: a checkpoint, or a policy.

    Returns:
        Policy steps that the other run was trained for.

    Raises:
        ArriveError: it cannot be read, or its robot, observation or network size differs.
    """
    samples = _take_policy(state, config, start) if isinstance(start, Policy) else _take_run(state, config, start)
    state.observations = state.env.get_observations()
    return samples


def _take_run(state: TrainingState, config: Config, path: Path) -> int:
    origin, saved = load_checkpoint(path)
    check_fits(origin, config.robot, state.env.observer.schema(), path)
    try:
        state.algorithm.load(saved["algorithm"], None, True)
        levels = reached_levels(saved, origin.config.terrain)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise _misfit(path, error) from error
    state.env.start_at_levels(levels)
    return origin.samples


def _take_policy(state: TrainingState, config: Config, policy: Policy) -> int:
    policy.check(state.env)
    try:
        state.algorithm.get_policy().load_state_dict(policy.actor.state_dict())
    except RuntimeError as error:
        raise _misfit(policy.path, error) from error
    return policy.samples


def _misfit(path: Path, error: Exception) -> ArriveError:
    return ArriveError(f"the networks in {path} do not fit: choose the same ppo.hidden. ({error})")


def reached_levels(saved: dict[str, Any], terrain: TerrainConfig) -> dict[str, Tensor]:
    """Levels of a checkpoint's robots by terrain family, from 0 (easiest) to 1 (hardest)."""
    parts = [part["env"]["levels"] for part in (saved, *saved["others"])]
    levels = torch.cat(parts) / max(terrain.levels - 1, 1)
    family = torch.cat([assign_families(len(part), len(terrain.families)) for part in parts])
    return {name: levels[family == index] for index, name in enumerate(terrain.families)}
