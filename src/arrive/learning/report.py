"""The report of one training iteration, which display, log, curves and TensorBoard use."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class FamilyReport:
    """Success, levels and failures of the robots on one terrain family."""

    arrival: float
    """Success rate of recently finished episodes, NaN before the first one."""
    mean_level: float
    """Mean terrain level of the robots on this family."""
    levels: tuple[int, ...]
    """Number of robots on each level."""
    failures: dict[str, float] = field(default_factory=dict)
    """Share of the family's recently finished episodes per cause of failure."""


@dataclass(frozen=True)
class IterationReport:
    """One iteration: progress, success, rewards and losses, all by name."""

    iteration: int
    samples: int
    """Policy steps since the run started, over all environments."""
    elapsed_s: float
    """Training time since the run started, over all resumed parts [s]."""
    budget: float
    """Share of the run's budget (minutes, iterations or samples) that is spent, 0 to 1."""
    time_left_s: float
    samples_per_s: float
    arrival: float
    """Success rate of recently finished episodes, NaN before the first one."""
    diverged_share: float
    """Share of the recently ended episodes that ended because the simulation diverged."""
    exploration_paid: float
    """Share of the robots to which the exploration reward (paper, eq. 3) is still paid."""
    task_fraction: float
    """Task reward inside its window as a share of its maximum, mean of the families."""
    families: dict[str, FamilyReport] = field(default_factory=dict)
    rewards: dict[str, float] = field(default_factory=dict)
    """Mean weighted reward of each term per step, over the iteration."""
    failures: dict[str, float] = field(default_factory=dict)
    """Share of recently finished episodes per cause of failure."""
    learning: dict[str, float] = field(default_factory=dict)
    """Losses, learning rate, action standard deviation."""
    warnings: dict[str, str] = field(default_factory=dict)
    """Signs that nothing is learnt: name, and a text with the observation and its likely causes."""

    def scalars(self) -> dict[str, float]:
        """Every value under its flat name, as in TensorBoard and the CSV log."""
        flat = {
            "progress/samples": float(self.samples),
            "progress/elapsed_s": self.elapsed_s,
            "progress/samples_per_s": self.samples_per_s,
            "arrival/all": self.arrival,
            "episodes/diverged": self.diverged_share,
            "exploration/paid": self.exploration_paid,
            "exploration/task_fraction": self.task_fraction,
        }
        for name, family in self.families.items():
            flat[f"arrival/{name}"] = family.arrival
            flat[f"level/{name}"] = family.mean_level
        for group in ("rewards", "failures", "learning"):
            flat |= {f"{group}/{name}": value for name, value in getattr(self, group).items()}
        return flat | {f"warnings/{name}": 1.0 for name in self.warnings}
