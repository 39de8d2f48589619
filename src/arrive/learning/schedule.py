"""The training schedule: find a gait, then climb the levels, then finish with little noise.

A gait is found on a terrain family once the task reward there reaches half of its maximum.

No single setting suits all three stages. Finding a gait needs much action noise and cheap falls. Later the same noise
makes the robot trip. And the policy is evaluated without noise, so the last part of a run uses little noise, small
updates, expensive falls, and a mix of easy and hard levels.
"""

from dataclasses import dataclass

from arrive.config import Config, ScheduleConfig

MAX_STD = 1e3
"""Bound on the action noise that has no effect."""


@dataclass(frozen=True)
class Settings:
    """The values of the schedule for one iteration."""

    entropy: float
    """Weight of the entropy bonus."""
    desired_kl: float
    """KL divergence per update, to which the learning rate is adapted."""
    max_std: float
    """Upper bound on the standard deviation of the action noise."""
    crash_cost: float
    """Cost of a crash, positive."""
    review: float
    """Share of the episodes on a random easier level."""
    decimation: int
    """Physics steps per policy step."""
    calm: bool
    """Whether there are neither pushes nor new targets within an episode."""


def settings_at(config: Config, spent: float, seeking: float) -> Settings:
    """The settings at this point of a run.

    During the climb, the bound on the action noise falls geometrically with the budget. In the first half of the
    finish, all values change linearly to their last value.

    Args:
        spent: spent share of the budget, 0 to 1.
        seeking: share of the robots on terrain families that are still in the gait stage.
    """
    schedule, first = config.schedule, config.ppo
    if not schedule.enabled:
        return _constant(config, first.entropy)
    finish = _finish_share(schedule, spent)
    climb_std = schedule.climb_std * (schedule.finish_std / schedule.climb_std) ** spent
    climbed = Settings(
        entropy=schedule.climb_entropy * (1.0 - finish),
        desired_kl=_between(schedule.climb_kl, schedule.finish_kl, finish),
        max_std=_between(climb_std, schedule.finish_std, finish),
        crash_cost=_between(schedule.climb_crash_cost, schedule.finish_crash_cost, finish),
        review=_between(schedule.climb_review, schedule.finish_review, finish),
        decimation=config.physics.decimation if spent >= schedule.finish_from else _climb_steps(config),
        calm=False,
    )
    if seeking <= 0.0 or finish > 0.0:
        return climbed
    return _constant(config, _between(climbed.entropy, first.entropy, seeking))


def _constant(config: Config, entropy: float) -> Settings:
    """The settings of the configuration itself, without a schedule."""
    return Settings(
        entropy=entropy,
        desired_kl=config.ppo.desired_kl,
        max_std=MAX_STD,
        crash_cost=-config.task.rewards.crash_cost.weight,
        review=0.0,
        decimation=config.physics.decimation,
        calm=config.schedule.enabled and config.schedule.calm_gait,
    )


def _climb_steps(config: Config) -> int:
    """Physics steps per policy step while the levels rise. An actuator network keeps its own step."""
    steps = config.schedule.decimation
    return steps if steps and config.physics.motor != "network" else config.physics.decimation


def _finish_share(schedule: ScheduleConfig, spent: float) -> float:
    """Progress from the climb's values to the last values, 0 to 1."""
    if schedule.finish_from >= 1.0:
        return 0.0
    return min(max((spent - schedule.finish_from) / (0.5 * (1.0 - schedule.finish_from)), 0.0), 1.0)


def _between(first: float, last: float, share: float) -> float:
    return first + (last - first) * share
