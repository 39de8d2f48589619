"""Meaning of the columns of `log.csv`. `docs/metrics.md` is generated from this."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """One value per iteration, in the log and in TensorBoard."""

    name: str
    """Name of its column. A word in capitals stands for a terrain family, a reward or a warning."""
    unit: str
    meaning: str

    def describes(self, column: str) -> bool:
        """Whether this metric describes a column of the log."""
        group, _, rest = self.name.partition("/")
        return column == self.name or (rest.isupper() and column.startswith(f"{group}/"))


METRICS = (
    Metric("iteration", "1", "number of the PPO iteration, starting at 1"),
    Metric("progress/samples", "1", "policy steps of all robots since the run started"),
    Metric("progress/elapsed_s", "s", "training time since the run started, over all resumed parts"),
    Metric("progress/samples_per_s", "1/s", "policy steps of all robots per second, in this iteration"),
    Metric("arrival/all", "share", "success rate of the episodes that finished in the last 20 iterations"),
    Metric("arrival/FAMILY", "share", "the same on one terrain family"),
    Metric("level/FAMILY", "level", "mean terrain level of the robots on that family, from 0"),
    Metric(
        "episodes/diverged", "share", "episodes of the last 20 iterations that ended because the simulation diverged"
    ),
    Metric("exploration/paid", "share", "robots to which the exploration reward (paper, eq. 3) is still paid"),
    Metric("exploration/task_fraction", "share", "task reward in its window over its maximum, mean of the families"),
    Metric("rewards/TERM", "reward per step", "weighted reward of one term per policy step, mean of the iteration"),
    Metric("learning/value", "loss", "value loss of PPO, mean of the mini-batches"),
    Metric(
        "learning/explained_variance", "1", "share of the returns' variance predicted by the critic, before the update"
    ),
    Metric("learning/surrogate", "loss", "clipped surrogate loss of PPO, mean of the mini-batches"),
    Metric("learning/entropy", "nat", "entropy of the action distribution"),
    Metric("learning/learning_rate", "1", "learning rate after the update, adapted to the KL divergence"),
    Metric("learning/action_std", "action units", "standard deviation of the action noise, mean of the joints"),
    Metric("learning/crash_cost", "reward", "cost of a crash, set by the schedule"),
    Metric("learning/review", "share", "episodes on a random easier level, set by the schedule"),
    Metric("learning/entropy_bonus", "1", "weight of the entropy bonus, set by the schedule"),
    Metric("learning/diverged", "1", "robots reset because their simulation diverged, since the run started"),
    Metric(
        "failures/crash",
        "share",
        "recent episodes in which the base touched something; `episodes/diverged` has diverged simulations",
    ),
    Metric("failures/fell", "share", "recent episodes in which the base fell into a gap"),
    Metric("failures/late", "share", "recent episodes that ended away from the target with the robot still walking"),
    Metric("failures/stalled", "share", "recent episodes that ended away from the target with the robot standing"),
    Metric(
        "failures/wrong_side", "share", "recent episodes that ended with the terrain still between robot and target"
    ),
    Metric("warnings/NAME", "1", "1 in an iteration with a warning that nothing is learnt, otherwise empty"),
)
"""In the order of the documentation. The first metric that describes a column applies."""
