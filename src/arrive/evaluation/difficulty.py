"""The paper's protocol: how hard a terrain a policy still solves (section Maximum Terrain Difficulty, Table I)."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from arrive.build import OnProgress
from arrive.config import RandomisationConfig, to_dict
from arrive.errors import ArriveError
from arrive.evaluation.arrival import Arrival, Cell, CellResult, Conditions, evaluate
from arrive.evaluation.episode import Episode
from arrive.evaluation.playing import in_part
from arrive.evaluation.usage import usage_of
from arrive.learning.policy import Policy
from arrive.learning.rundir import commit
from arrive.task.final import arrival_radius
from arrive.task.task import Trial
from arrive.terrain import Family
from arrive.terrain.build import EVALUATION_TARGET
from arrive.terrain.levels import level_values

TRIAL = Trial(duration_s=8.0, target=EVALUATION_TARGET, speed=1.0, walk=4.0)
"""The paper's: 8 s, a target 5 m ahead for P_f and P_c, 1 m/s forward and 4 m to walk for V."""
START_YAW_RAD = 0.2
"""Start heading, within this of the straight line to the target [rad]."""
START_OFFSET = 0.1
"""Start position, within this per axis [m]."""
START_SPEED = 0.1
"""Start velocity of the base, within this per axis [m/s and rad/s]."""
START_JOINT_SCALE = 0.1
"""Start joint positions, the default ones times 1 +- this."""
VARIANTS = 50
"""Worlds per level, each with its own friction and payload and, where terrain is random, its own tile."""
SHARES = (0.95, 0.80, 0.50)
"""Success rates for which the largest solved parameter is given; the paper's is the first."""
NAME = "difficulty"


def _range(first: float, last: float, step: float) -> tuple[float, ...]:
    return tuple(round(first + i * step, 6) for i in range(round((last - first) / step) + 1))


LEVELS: dict[str, tuple[float, ...]] = {
    "rough": _range(0.02, 0.10, 0.02),
    "slope": _range(0.0, 55.0, 5.0),
    "slope_down": _range(0.0, 55.0, 5.0),
    "stairs": _range(0.05, 0.45, 0.05),
    "stairs_down": _range(0.05, 0.45, 0.05),
    "steps": _range(0.02, 0.24, 0.02),
    "obstacles": _range(0.25, 1.05, 0.05),
    "gap": _range(0.1, 1.4, 0.1),
    "pit": _range(0.05, 1.05, 0.05),
}
"""Parameters that are measured, past the paper's best; the others get `DEFAULT_LEVELS` of their own range."""
DEFAULT_LEVELS = 10


@dataclass(frozen=True)
class Measurement:
    """One policy on some families."""

    results: dict[str, list[CellResult]]
    """By family, easiest level first."""
    content: dict[str, Any]
    """The result as JSON data; nothing in it changes when the measurement is repeated."""
    episodes: list[Episode]
    """One recorded episode per family: the hardest level whose first robot succeeded, or else the easiest."""


def difficulty_cells(family: Family, levels: int | None) -> list[Cell]:
    """The cells of a family's table of levels, or of evenly spaced ones between its easiest and hardest parameter.

    Raises:
        ArriveError: fewer than one level.
    """
    values = LEVELS.get(family.name) if levels is None else None
    values = values or level_values(family, levels or DEFAULT_LEVELS)
    return [Cell(family, i, value) for i, value in enumerate(values)]


def randomised(config: RandomisationConfig) -> RandomisationConfig:
    """Small offsets of the start and no pushes; friction and payload as in training."""
    return replace(
        config,
        start_yaw_rad=START_YAW_RAD,
        start_offset=START_OFFSET,
        start_speed=START_SPEED,
        start_joint_scale=START_JOINT_SCALE,
        push_speed=0.0,
    )


def measure_difficulty(
    policy: Policy,
    families: Sequence[Family],
    episodes: int,
    seed: int,
    levels: int | None = None,
    threads: int = 0,
    progress: OnProgress = lambda done, total: None,
    chosen: dict[str, Cell] | None = None,
) -> Measurement:
    """Measure success against difficulty on the evaluation layouts, on terrain seeds apart from training's.

    Args:
        episodes: per level.
        levels: evenly spaced levels per family; None for the table `LEVELS`.
        progress: called with the policy steps done so far and their total.
        chosen: the only value that is measured of some families, by name.
    """
    chosen = chosen or {}
    setting = Conditions("evaluation", TRIAL, randomised, VARIANTS)
    answers: dict[str, Arrival] = {}
    for index, family in enumerate(families):
        cells = [chosen[family.name]] if family.name in chosen else difficulty_cells(family, levels)
        answers[family.name] = evaluate(
            policy, cells, episodes, seed, threads, in_part(progress, index, len(families)), setting
        )
    usage = {name: usage_of(answer, policy.config.physics.control_dt) for name, answer in answers.items()}
    results = {name: answer.results for name, answer in answers.items()}
    return Measurement(
        results=results,
        content={
            "families": {name: family_content(rows) for name, rows in results.items()},
            "policy": policy_content(policy) | {"usage": usage},
            "protocol": protocol_content(policy, episodes, seed, levels),
            "commit": commit(),
        },
        episodes=[telling(answer.episodes) for answer in answers.values()],
    )


def telling(episodes: Sequence[Episode]) -> Episode:
    """The hardest of a family's episodes, easiest first, that arrived; the easiest if none did."""
    solved = [episode for episode in episodes if episode.outcome == "arrived"]
    return solved[-1] if solved else episodes[0]


def family_content(results: Sequence[CellResult]) -> dict[str, Any]:
    """Success with its intervals at every level of a family, and the largest parameters solved."""
    family = results[0].cell.family
    levels = [result.content() for result in results]
    largest = {f"max_at_{share * 100:.0f}": max_at(results, share) for share in SHARES}
    return {"parameter": family.parameter, "unit": family.unit, "levels": levels} | largest


def max_at(results: Sequence[CellResult], share: float) -> float | None:
    """The largest parameter up to which every level is solved in at least this share of its episodes, or None.

    Args:
        results: easiest level first.
    """
    solved = None
    for result in results:
        # The tolerance takes 475 of 500 for 95 %, which 0.95 * 500 in floating point might not.
        if result.arrived < share * result.episodes - 1e-9:
            break
        solved = result.cell.value
    return solved


def origin_of(policy: Policy) -> dict[str, Any]:
    """Which policy was measured and where it is from."""
    config = policy.config
    return {
        "name": policy.name,
        "task": config.task.name,
        "preset": config.preset,
        "terrain": list(config.terrain.families),
        "seed": config.seed,
        "samples": policy.samples,
        "commit": policy.commit,
    }


def policy_content(policy: Policy) -> dict[str, Any]:
    """The same with all that it was trained with."""
    config = policy.config
    return origin_of(policy) | {"episode_s": config.task.episode_s, "config": to_dict(config)}


def protocol_content(policy: Policy, episodes: int, seed: int, levels: int | None) -> dict[str, Any]:
    """Everything that the figures depend on besides policy and code."""
    randomisation, task = randomised(policy.config.randomisation), policy.config.task
    return {
        "name": NAME,
        "episodes": episodes,
        "seed": seed,
        "levels": levels,
        "layout": "evaluation",
        "terrain_m": 4.0,
        "trial": asdict(TRIAL) | {"target": list(TRIAL.target)},
        "arrival_radius_m": arrival_radius(task),
        "worlds_per_level": VARIANTS,
        "randomisation": to_dict(randomisation),
        "observation_noise": policy.config.observation.noise,
        "success": (
            "within the arrival radius of the target when the time is over, without a crash; for the task `velocity` "
            "a longer way along x than the trial's, even with a crash afterwards"
        ),
        "note": (
            f"the time given is {TRIAL.duration_s:g} s; this policy was trained with episodes of at most "
            f"{policy.config.task.episode_s:g} s, and a time left above that is shown to it as that"
        ),
    }


def check_levels(levels: int | None) -> None:
    """Refuse a number of levels that is out of range.

    Raises:
        ArriveError: fewer than one level.
    """
    if levels is not None and levels < 1:
        raise ArriveError(f"--levels must be at least 1, not {levels}")
