"""Detects that a training learns nothing, and names likely causes."""

from collections.abc import Iterator
from dataclasses import replace

from arrive.learning.report import IterationReport

DIVERGED_SHARE = 0.5
"""Share of the recent episodes that diverged. In a sound simulation it is below one in a thousand."""
CRASHED_SHARE, CRASHED_SAMPLES, CRASHED_ITERATIONS = 0.95, 1_000_000, 60
"""New networks crash in 70 % of the episodes after half a million samples, and in 30 to 40 % after one million."""
ARRIVED_SHARE, ARRIVED_SAMPLES, ARRIVED_ITERATIONS = 0.02, 3_000_000, 200
"""With the presets, robots arrive in 4 to 10 % of the episodes after one million samples, and in 80 % after two."""
STUCK_LEVEL, STUCK_SAMPLES, STUCK_ITERATIONS = 0.1, 2_000_000, 200
"""If robots learn on a family at all, their mean level passes this within a million samples on that family."""
LEAST_LEVELS = 2
"""A family with fewer levels has no curriculum."""


def find_warnings(report: IterationReport) -> IterationReport:
    """The report with warnings added, if its values call for any."""
    return replace(report, warnings=dict(_warnings(report)))


def _warnings(report: IterationReport) -> Iterator[tuple[str, str]]:
    """Name and text of each warning."""
    diverging = report.diverged_share > DIVERGED_SHARE
    crashing = _crashing(report)
    if diverging:
        yield (
            "diverging",
            f"{report.diverged_share:.0%} of the episodes end because the simulation diverges. Likely causes: "
            "physics.timestep_s too long, contacts or gains too stiff, randomisation (start_speed, push_speed, "
            "payload_kg) too strong.",
        )
    if crashing and not diverging:
        yield (
            "crashing",
            f"{_crashed(report):.0%} of the episodes end in a crash after {_millions(report)} samples. Likely "
            "causes: randomisation too strong, action noise (ppo.init_std, ppo.entropy) "
            "too large, or nothing that rewards staying upright.",
        )
    if _never_arriving(report) and not (diverging or crashing):
        yield (
            "arriving",
            f"{report.arrival:.0%} of the episodes arrive after {_millions(report)} samples. Likely causes: no reward "
            "that guides robots to the target (exploration, approach, pace), targets too far for task.episode_s, "
            "penalties that outweigh the task reward, ppo.gamma too small.",
        )
    if stuck := _stuck_families(report):
        yield (
            "levels",
            f"the robots on {', '.join(stuck)} are still on the first level after {_millions(report)} samples. Likely "
            "causes: the first level is too hard (more terrain.levels make it easier), terrain.demotion_share "
            "too large.",
        )


def _crashing(report: IterationReport) -> bool:
    late = report.samples >= CRASHED_SAMPLES and report.iteration >= CRASHED_ITERATIONS
    return late and _crashed(report) > CRASHED_SHARE


def _never_arriving(report: IterationReport) -> bool:
    late = report.samples >= ARRIVED_SAMPLES and report.iteration >= ARRIVED_ITERATIONS
    return late and report.arrival < ARRIVED_SHARE


def _stuck_families(report: IterationReport) -> list[str]:
    """Families with a curriculum whose robots are almost all on the first level after enough samples."""
    robots = sum(sum(family.levels) for family in report.families.values())
    return [
        name
        for name, family in report.families.items()
        if len(family.levels) >= LEAST_LEVELS
        and family.mean_level < STUCK_LEVEL
        and report.iteration >= STUCK_ITERATIONS
        and report.samples * sum(family.levels) / robots >= STUCK_SAMPLES
    ]


def _millions(report: IterationReport) -> str:
    return f"{report.samples / 1e6:.1f} M"


def _crashed(report: IterationReport) -> float:
    """Share of the episodes that ended in a crash or a fall off the terrain."""
    return sum(report.failures.get(cause, 0.0) for cause in ("crash", "fell"))
