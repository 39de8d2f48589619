"""Robots that walk on and on over flat ground by a constant command, for the measurements of energy and gait."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from arrive.build import Placement, build_env
from arrive.config import to_dict
from arrive.env import ArriveEnv
from arrive.errors import ArriveError
from arrive.evaluation.difficulty import VARIANTS, randomised
from arrive.learning.policy import Policy
from arrive.task.continuous import ContinuousPositionTask
from arrive.task.final import FinalPositionTask
from arrive.task.registry import get_task
from arrive.task.task import ConstantCommand
from arrive.task.velocity import VelocityTask
from arrive.terms import LEAD_M
from arrive.terrain.levels import EVALUATION_SEED_OFFSET

LEAD_S = 3.0
"""The target stays as far ahead of a continuous-position policy as the speed leads in this time [s]."""
TERRAIN = "flat"


@dataclass(frozen=True)
class Heading:
    """A commanded speed and direction."""

    speed: float
    """[m/s]."""
    direction_deg: float = 0.0
    """Of travel, relative to the heading at the start, counterclockwise [deg]."""


def walking_env(
    policy: Policy, commands: list[Heading], robots: int, duration_s: float, seed: int, threads: int
) -> ArriveEnv:
    """Robots on endless flat ground, `robots` for each command in turn, with full noise and without pushes.

    Friction and payload are those of training, the starts those of the protocol of maximum difficulty.

    Args:
        duration_s: the longest walk [s].

    Raises:
        ArriveError: the policy's task cannot be commanded so, or it is one of another observation.
    """
    headings = [heading for heading in commands for _ in range(robots)]
    constant = constant_command(policy, headings, duration_s)
    n, config = len(headings), policy.config
    config = replace(
        config,
        num_envs=n,
        seed=seed,
        terrain=replace(config.terrain, families=(TERRAIN,), variants=VARIANTS),
        observation=replace(config.observation, noise=True, noise_least=1.0),
        randomisation=randomised(config.randomisation),
    )
    nowhere = torch.zeros(n, dtype=torch.long, device=policy.device)
    placement = Placement(trial=constant, seed_offset=EVALUATION_SEED_OFFSET, assignment=(nowhere, nowhere))
    env = build_env(config, placement, threads)
    policy.check(env)
    return env


def constant_command(policy: Policy, headings: list[Heading], duration_s: float) -> ConstantCommand:
    """The constant command of each robot, by the policy's task (paper, section Energy Consumption).

    V gets its speed. P_f gets a target that stays `LEAD_M` ahead, and a constant remaining time of LEAD_M / speed. P_c
    gets a target that stays speed * `LEAD_S` ahead, in the middle of its time. Give `possible` speeds alone.

    Raises:
        ArriveError: the task is none of these, or it cannot walk in such a direction.
    """
    task = get_task(policy.config.task.name)
    check_command(policy, headings)
    speed = torch.tensor([heading.speed for heading in headings])
    angle = torch.tensor([math.radians(heading.direction_deg) for heading in headings])
    ahead = torch.stack([angle.cos(), angle.sin()], dim=-1)
    episode_s = policy.config.task.episode_s
    if issubclass(task, ContinuousPositionTask):
        lead, time_left = speed * LEAD_S, torch.full_like(speed, episode_s / 2)
    else:
        lead, time_left = torch.full_like(speed, LEAD_M), LEAD_M / speed
    return ConstantCommand(
        duration_s=duration_s,
        offset_w=(lead[:, None] * ahead).to(policy.device),
        time_left_s=time_left.to(policy.device),
        speed=torch.where(ahead[:, 0] < 0.0, -speed, speed).to(policy.device),
        heading=torch.zeros_like(speed).to(policy.device),
    )


def conditions(policy: Policy) -> dict[str, Any]:
    """What the robots of `walking_env` are like, as JSON data."""
    return {"randomisation": to_dict(randomised(policy.config.randomisation)), "worlds": VARIANTS}


def slowest_speed(policy: Policy) -> float:
    """The slowest speed that the policy can be commanded [m/s].

    A policy of `final` observes at most one episode of remaining time, so it cannot tell slower commands from this one.
    """
    task = get_task(policy.config.task.name)
    timed = issubclass(task, FinalPositionTask) and not issubclass(task, ContinuousPositionTask)
    return LEAD_M / policy.config.task.episode_s if timed else 0.0


def possible(policy: Policy, headings: Sequence[Heading]) -> list[Heading]:
    """The commands that the policy really gets, each once: slower ones become `slowest_speed`."""
    slowest = slowest_speed(policy)
    return list(dict.fromkeys(replace(heading, speed=max(heading.speed, slowest)) for heading in headings))


def slower_words(policy: Policy, speeds: Sequence[float]) -> str:
    """A line for the user about commanded speeds that the policy cannot tell from its slowest; "" if there are none."""
    slowest = slowest_speed(policy)
    slower = [f"{speed:g}" for speed in dict.fromkeys(speeds) if speed < slowest]
    if not slower:
        return ""
    return (
        f"{policy.name}: {', '.join(slower)} m/s is below its slowest command of {slowest:.3g} m/s ({LEAD_M:g} m in an "
        f"episode of {policy.config.task.episode_s:g} s), which was measured instead"
    )


def check_command(policy: Policy, headings: Sequence[Heading] = ()) -> None:
    """Refuse what cannot be commanded.

    Raises:
        ArriveError: the policy's task takes no constant command, or it cannot walk in such a direction.
    """
    name = policy.config.task.name
    task = get_task(name)
    if not issubclass(task, FinalPositionTask | VelocityTask):
        raise ArriveError(
            f"{policy.path}: the task {name!r} takes no constant command; "
            "give policies of 'velocity', 'continuous' or 'final'"
        )
    sideways = sorted({heading.direction_deg for heading in headings if heading.direction_deg % 180.0})
    if issubclass(task, VelocityTask) and sideways:
        listed = ", ".join(f"{direction:g}" for direction in sideways)
        raise ArriveError(
            f"{policy.path}: the task {name!r} walks forward (0) or backward (180) only, not towards {listed} deg"
        )


def check_speeds(speeds: tuple[float, ...]) -> None:
    """Refuse speeds that cannot be commanded.

    Raises:
        ArriveError: none, or one that is not positive and finite.
    """
    if not speeds or not all(0.0 < speed <= 10.0 for speed in speeds):
        raise ArriveError(
            f"--speeds must be numbers above 0 and up to 10 m/s, not {' '.join(map(str, speeds)) or 'none'}"
        )
