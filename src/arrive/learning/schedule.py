"""What changes while a policy is trained: first find a gait, then climb the levels, finish quietly.

A single setting serves none of the three well. A gait is found with much noise and cheap falls. A robot that has one
trips over the same noise. And the policy that is measured acts without any, so the last part of a run trains it with
little noise, small steps, dear falls, and easy levels among the hard ones.
"""

from dataclasses import dataclass

from arrive.config import Config, ScheduleConfig

GAIT, CLIMB, FINISH = "gait", "climb", "finish"
MAX_STD = 1e3
"""Stands for no bound on the action noise."""


@dataclass(frozen=True)
class Settings:
    """What the schedule decides for one iteration."""

    stage: str
    """`gait` until the task reward is at half of its maximum on every terrain family, then `climb`, then `finish`."""
    entropy: float
    """Weight of the entropy bonus."""
    desired_kl: float
    """KL divergence per update that the learning rate is adapted to."""
    max_std: float
    """The standard deviation of the action noise is cut at this."""
    crash_cost: float
    """What a crash costs, positive."""
    review: float
    """Share of the episodes on a random easier level."""


def settings_at(config: Config, spent: float, seeking: float) -> Settings:
    """What holds at this point of a run.

    While climbing, the bound on the action noise falls geometrically with the budget; in the finish everything has gone
    over to its last value after half of the finish, linearly.

    Args:
        spent: share of the budget, 0 to 1.
        seeking: share of the robots whose terrain family still seeks its gait.
    """
    schedule, first = config.schedule, config.ppo
    if not schedule.enabled:
        return _constant(config, first.entropy)
    finish = _finish_share(schedule, spent)
    climb_std = schedule.climb_std * (schedule.finish_std / schedule.climb_std) ** spent
    climbed = Settings(
        stage=FINISH if spent >= schedule.finish_from else CLIMB,
        entropy=schedule.climb_entropy * (1.0 - finish),
        desired_kl=_between(schedule.climb_kl, schedule.finish_kl, finish),
        max_std=_between(climb_std, schedule.finish_std, finish),
        crash_cost=_between(schedule.climb_crash_cost, schedule.finish_crash_cost, finish),
        review=_between(schedule.climb_review, schedule.finish_review, finish),
    )
    if seeking <= 0.0 or finish > 0.0:
        return climbed
    return _constant(config, _between(climbed.entropy, first.entropy, seeking))


def _constant(config: Config, entropy: float) -> Settings:
    """What the configuration says itself."""
    return Settings(
        stage=GAIT,
        entropy=entropy,
        desired_kl=config.ppo.desired_kl,
        max_std=MAX_STD,
        crash_cost=-config.task.rewards.crash_cost.weight,
        review=0.0,
    )


def _finish_share(schedule: ScheduleConfig, spent: float) -> float:
    """How much of the way to the last values has been gone, 0 to 1."""
    if schedule.finish_from >= 1.0:
        return 0.0
    return min(max((spent - schedule.finish_from) / (0.5 * (1.0 - schedule.finish_from)), 0.0), 1.0)


def _between(first: float, last: float, share: float) -> float:
    return first + (last - first) * share
