"""Success rates by the target's distance and direction and by the time given, and whether robots then wait there."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from arrive.build import OnProgress
from arrive.config import to_dict
from arrive.errors import ArriveError
from arrive.evaluation.arrival import Arrival, Cell, Conditions, evaluate
from arrive.evaluation.difficulty import TRIAL, VARIANTS, policy_content, randomised
from arrive.evaluation.wilson import wilson_interval
from arrive.learning.policy import Policy
from arrive.learning.rundir import commit
from arrive.task.final import PositionConfig
from arrive.terms import hold_time
from arrive.terrain import Layout
from arrive.terrain.family import Family
from arrive.terrain.ground import Ground

NAME = "reach"
REACH_NAME = "reach.json"
"""File of a measurement beside the policy."""
DISTANCES = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
"""Of targets from the start [m]."""
DIRECTIONS = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)
"""Of targets, relative to the heading at the start, counterclockwise [deg]."""
TIMES = (3.0, 5.0, 8.0, 10.0)
"""Given to get there [s]."""
FARTHEST = 6.4
"""The ground is not known beyond this distance [m]."""
WAIT_S = 30.0
"""How long robots wait at their target [s]."""
MOVED_M = 0.05
"""A target that stands this far from where it was asked for was moved [m]."""


@dataclass(frozen=True)
class ReachGrid:
    """The distances, directions and times of a measurement."""

    distances: tuple[float, ...] = DISTANCES
    directions: tuple[float, ...] = DIRECTIONS
    times: tuple[float, ...] = TIMES
    layout: Layout = "evaluation"

    def check(self) -> None:
        """Refuse a grid that cannot be run.

        Raises:
            ArriveError: no distances, directions or times, or one out of range.
        """
        _check("--target-distance", self.distances, 0.1, FARTHEST, "m")
        _check("--direction", self.directions, -360.0, 360.0, "deg")
        _check("--time", self.times, 0.1, 60.0, "s")

    @property
    def ahead(self) -> float:
        """The direction of the tables by distance and time: straight ahead, or the first that was asked for [deg]."""
        return 0.0 if 0.0 in self.directions else self.directions[0]

    @property
    def time_s(self) -> float:
        """The time of the table by direction and of waiting: the one nearest to the protocol's [s]."""
        return min(self.times, key=lambda time: abs(time - TRIAL.duration_s))

    def batches(self, episodes: int) -> list["Batch"]:
        """The episodes on each terrain: one batch for each time, then one for all directions, then one for waiting.

        Args:
            episodes: least number per row of a table.
        """
        ahead = [(distance, self.ahead) for distance in self.distances]
        around = [(distance, direction) for direction in self.directions for distance in self.distances]
        shared = math.ceil(episodes / len(self.distances))
        return [
            *(Batch(ahead, time_s, episodes) for time_s in self.times),
            Batch(around, self.time_s, shared),
            Batch(ahead, self.time_s, shared, WAIT_S),
        ]


@dataclass(frozen=True)
class Batch:
    """Episodes of the same length with several targets."""

    targets: list[tuple[float, float]]
    """Distance [m] and direction [deg] of each."""
    time_s: float
    episodes: int
    """Per target."""
    wait_s: float = 0.0
    """How long robots must then stay at the target."""


def _check(option: str, values: Sequence[float], least: float, most: float, unit: str) -> None:
    if not values or not all(least <= value <= most for value in values):
        given = ",".join(f"{value:g}" for value in values) or "nothing"
        raise ArriveError(f"{option} must be numbers from {least:g} to {most:g} {unit}, joined by commas, not {given}")
    if len(set(values)) < len(values):
        raise ArriveError(f"{option} names a value twice: {','.join(f'{value:g}' for value in values)}")


def check_policy(policy: Policy) -> PositionConfig:
    """The configuration of a policy's task; refuse policies whose task has no targets.

    Raises:
        ArriveError: its task has no targets.
    """
    task = policy.config.task
    if not isinstance(task, PositionConfig):
        raise ArriveError(
            f"{policy.path}: the task {task.name!r} has no targets, so it has no distance, direction and "
            "time of them; measure it with --protocol difficulty"
        )
    return task


def hardest_solved(solved: dict[str, float], family: Family, levels: int) -> float:
    """The hardest value that a policy was measured to solve, or that of a middle level.

    Args:
        solved: by family, see `arrive.policies.solved`.
        levels: number of the policy's own levels.
    """
    return solved.get(family.name, family.value(levels // 2, levels))


def measure_reach(
    policy: Policy,
    grounds: Sequence[Ground],
    grid: ReachGrid,
    episodes: int,
    seed: int,
    threads: int = 0,
    progress: OnProgress = lambda done, total: None,
) -> dict[str, Any]:
    """Send robots to every distance by every time, to every direction, and let them wait.

    Robots start as in the protocol of maximum difficulty: facing along the tile's x axis, without pushes. A target that
    would lie in a hole is moved to the next valid place straight behind it.

    Args:
        grounds: of different families; their layout is not looked at.
        episodes: behind every row of a table.
        progress: called with the policy steps done so far and their total.

    Returns:
        The result as JSON data; nothing in it changes when the measurement is repeated.

    Raises:
        ArriveError: nothing to measure, or a policy whose task has no targets.
    """
    grid.check()
    check_policy(policy)
    batches, control_dt = grid.batches(episodes), policy.config.physics.control_dt
    steps = [round((batch.time_s + batch.wait_s) / control_dt) for batch in batches]
    total, before = sum(steps) * len(grounds), 0
    families = {}
    for ground in grounds:
        answers = []
        for batch, own in zip(batches, steps, strict=True):

            def advanced(done: int, of: int, before: int = before, own: int = own) -> None:
                progress(before + own * done // of, total)

            answers.append(_run(policy, ground, grid.layout, batch, seed, threads, advanced))
            before += own
        families[ground.family.name] = _tables(grid, ground, answers, policy)
    protocol = _protocol(policy, grid, episodes, seed)
    return {
        "families": families,
        "policy": policy_content(policy),
        "protocol": protocol | {"effort": effort(grid, episodes, len(grounds))},
        "commit": commit(),
    }


def effort(grid: ReachGrid, episodes: int, grounds: int) -> int:
    """Number of episodes of a whole measurement."""
    return grounds * sum(len(batch.targets) * batch.episodes for batch in grid.batches(episodes))


def _run(
    policy: Policy, ground: Ground, layout: Layout, batch: Batch, seed: int, threads: int, progress: OnProgress
) -> Arrival:
    trial = replace(TRIAL, duration_s=batch.time_s, wait_s=batch.wait_s, hold_s=hold_time(check_policy(policy)))
    cells = [Cell(ground.family, None, ground.value, _in_tile(*target)) for target in batch.targets]
    setting = Conditions(layout, trial, randomised, VARIANTS, record=False)
    return evaluate(policy, cells, batch.episodes, seed, threads, progress, setting)


def _in_tile(distance: float, direction_deg: float) -> tuple[float, float]:
    angle = math.radians(direction_deg)
    return distance * math.cos(angle), distance * math.sin(angle)


def _tables(grid: ReachGrid, ground: Ground, answers: Sequence[Arrival], policy: Policy) -> dict[str, Any]:
    """The tables of one terrain.

    Args:
        answers: of `ReachGrid.batches`, in their order.
    """
    *by_time, around, waited = answers
    count, family = len(grid.distances), ground.family
    return {
        "parameter": family.parameter,
        "unit": family.unit,
        "value": ground.value,
        "distances": [
            _row(answer, [i], distance, grid.ahead, time_s)
            for time_s, answer in zip(grid.times, by_time, strict=True)
            for i, distance in enumerate(grid.distances)
        ],
        "directions": [
            _row(around, range(i * count, (i + 1) * count), None, direction, grid.time_s)
            for i, direction in enumerate(grid.directions)
        ],
        "waiting": _waiting(waited, check_policy(policy).arrival_radius, grid.time_s, policy.config.physics.control_dt),
    }


def _row(
    answer: Arrival, cells: Sequence[int], distance: float | None, direction_deg: float, time_s: float
) -> dict[str, Any]:
    """One row of a table, of several cells together.

    Args:
        distance: None where the cells are of all distances.
    """
    results = [answer.results[i] for i in cells]
    arrived, episodes = (sum(getattr(result, name) for result in results) for name in ("arrived", "episodes"))
    failures = sum((Counter(result.failures) for result in results), Counter())
    mine = torch.isin(answer.cell_of_episode, torch.tensor(list(cells)))
    stood = torch.cat([part.target_w for part in answer.played])[mine, :2].norm(dim=-1).mean()
    row: dict[str, Any] = {
        "distance_m": distance,
        "direction_deg": direction_deg,
        "time_s": time_s,
        "episodes": episodes,
        "success": arrived / episodes,
        "interval": list(wilson_interval(arrived, episodes)),
        "failures": dict(sorted(failures.items())),
    }
    moved = distance is not None and abs(float(stood) - distance) > MOVED_M
    return row | ({"stood_at_m": round(float(stood), 3)} if moved else {})


def _waiting(answer: Arrival, radius: float, time_s: float, control_dt: float) -> dict[str, Any]:
    """How many of the robots that had arrived when the time was over still stood there after the wait."""
    arrived = stayed = 0
    failures: Counter[str] = Counter()
    for part in answer.played:
        at = round(time_s / control_dt)
        distance = (part.trace_w[at] - part.target_w).norm(dim=-1)
        there = (distance < radius) & (part.steps > at)
        arrived += int(there.sum())
        stayed += int((there & part.success).sum())
        failures.update(cause for cause, was in zip(part.cause, there.tolist(), strict=True) if was and cause)
    return {
        "wait_s": WAIT_S,
        "time_s": time_s,
        "arrived": arrived,
        "stayed": stayed,
        "share": stayed / arrived if arrived else None,
        "interval": list(wilson_interval(stayed, arrived)) if arrived else None,
        "failures": dict(sorted(failures.items())),
    }


def _protocol(policy: Policy, grid: ReachGrid, episodes: int, seed: int) -> dict[str, Any]:
    task = check_policy(policy)
    return {
        "name": NAME,
        "episodes": episodes,
        "seed": seed,
        "layout": grid.layout,
        "distances_m": list(grid.distances),
        "directions_deg": list(grid.directions),
        "times_s": list(grid.times),
        "arrival_radius_m": task.arrival_radius,
        "worlds": VARIANTS,
        "randomisation": to_dict(randomised(policy.config.randomisation)),
        "success": "within the arrival radius of the target when the time is over, without a crash",
        "by_distance": f"in the direction {grid.ahead:g} deg, for each time given",
        "by_direction": (
            f"all distances in equal parts, within {grid.time_s:g} s; angles are relative to the heading at the start"
        ),
        "waiting": (
            f"robots that arrived within {grid.time_s:g} s stay {WAIT_S:g} s longer, all distances in equal parts; "
            f"meanwhile the policy observes a time left of {hold_time(task):g} s, as on a robot"
        ),
        "holes": "a target in a hole is moved straight back to the next valid place",
    }
