"""Reports of an imaginary training."""

import math
from dataclasses import replace

from arrive.learning.report import FamilyReport, IterationReport


def make_report(iteration: int, **changes) -> IterationReport:
    """A report of an imaginary run of 100 iterations."""
    report = IterationReport(
        iteration=iteration,
        samples=24576 * iteration,
        elapsed_s=3.7 * iteration,
        budget=iteration / 100,
        time_left_s=3.7 * (100 - iteration),
        samples_per_s=6512.0,
        arrival=math.nan if iteration < 3 else 0.42,
        diverged_share=0.0,
        exploration_paid=float(iteration < 50),
        task_fraction=0.31,
        families={
            "flat": FamilyReport(0.9, 0.0, (64,)),
            "stairs": FamilyReport(0.27, 1.5, (8, 40, 16, 0)),
        },
        rewards={"final_position": 0.0712, "torque_cost": -0.0047},
        failures={"base_contact": 0.21, "too_far": 0.04},
        learning={"value_loss": 0.03, "action_std": 0.8, "learning_rate": 1e-3},
    )
    return replace(report, **changes)
