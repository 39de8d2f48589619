"""Which of the paper's statements about energy, gaits and stability hold in what was measured."""

import statistics
from collections.abc import Sequence
from typing import Any

import numpy as np

from arrive.evaluation.wilson import wilson_interval
from arrive.report.records import SYMBOLS, Measured

ALIKE = 1.25
"""Costs are about the same if the largest is at most this times the smallest. The paper gives no figure for this."""


def energy_statements(content: dict[str, Any]) -> list[dict[str, str]]:
    """The paper's statements on figure 4, each `holds`, `fails` or `open`, and why.

    Costs are compared at the same speed, the slowest or the fastest that all compared policies reach. A cost at a speed
    between two measured ones is interpolated. A statement is open if the 95 % intervals allow both answers.

    Args:
        content: of `energy_content`.
    """
    return [
        _cheaper(content, "final", "velocity", fast=False),
        _cheaper(content, "continuous", "final", fast=True),
        _alike(content),
    ]


def _cheaper(content: dict[str, Any], better: str, worse: str, fast: bool) -> dict[str, str]:
    where = "at high speed" if fast else "at low speed"
    claim = f"{SYMBOLS[better]} needs less than {SYMBOLS[worse]} {where}"
    found = _costs(content, (better, worse), fast)
    if found is None:
        return _statement(claim, "open", "both must be measured at a speed that both reach")
    speed, (first, second) = found
    verdict = "holds" if first[2] <= second[1] else "fails" if first[1] >= second[2] else "open"
    return _statement(claim, verdict, f"{first[0]:.0f} against {second[0]:.0f} N² m² s/m at {speed:.2f} m/s")


def _alike(content: dict[str, Any]) -> dict[str, str]:
    claim = "All need about the same at high speed"
    found = _costs(content, tuple(SYMBOLS), fast=True)
    if found is None:
        return _statement(claim, "open", "all three must be measured at a speed that all reach")
    speed, costs = found
    values, lows, highs = zip(*costs, strict=True)
    least, most = min(values), max(values)
    verdict = "holds" if max(highs) <= ALIKE * min(lows) else "fails" if max(lows) > ALIKE * min(highs) else "open"
    return _statement(claim, verdict, f"{least:.0f} to {most:.0f} N² m² s/m at {speed:.2f} m/s")


def _costs(
    content: dict[str, Any], tasks: Sequence[str], fast: bool
) -> tuple[float, list[tuple[float, float, float]]] | None:
    """The slowest or fastest speed that policies of all tasks reach, and each task's cost there with its interval."""
    policies = Measured.of(content)
    curves = {
        task: [curve for policy in policies if policy.task == task and (curve := _curve(policy)) is not None]
        for task in tasks
    }
    if not all(curves.values()):
        return None
    speeds = [curve[0] for found in curves.values() for curve in found]
    slowest, fastest = max(speed[0] for speed in speeds), min(speed[-1] for speed in speeds)
    if slowest > fastest:
        return None
    at = fastest if fast else slowest
    return at, [_cost_at(at, found) for found in curves.values()]


def _cost_at(speed: float, curves: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """Mean cost of one task's policies at a speed, and the widest interval."""
    rows = [[float(np.interp(speed, curve[0], row)) for row in curve[1:]] for curve in curves]
    values, lows, highs = zip(*rows, strict=True)
    return statistics.mean(values), min(lows), max(highs)


def _curve(policy: Measured) -> np.ndarray | None:
    """Speed reached, cost and its interval's ends of a policy, (4, speeds), slowest first; None if no robot walked."""
    rows = [row for row in policy.content["speeds"] if row["torque_sq"] and row["speed"]]
    points = sorted((row["speed"][0], *row["torque_sq"]) for row in rows)
    return np.array(points).T if points else None


def gait_statements(content: dict[str, Any]) -> list[dict[str, str]]:
    """The paper's statements on figure 5: V trots, P_f and P_c do not.

    Args:
        content: of `gait_content`.
    """
    found = []
    for task, trots in (("velocity", True), ("final", False), ("continuous", False)):
        claim = f"{SYMBOLS[task]} {'trots' if trots else 'does not trot'}"
        mine = [policy for policy in Measured.of(content) if policy.task == task]
        gaits = [row["gait"] for policy in mine for row in policy.content["gaits"] if row["gait"]]
        if not gaits:
            found.append(_statement(claim, "open", "it does not walk, or was not measured"))
            continue
        share = gaits.count("trot") / len(gaits)
        holds = share > 0.5 if trots else share <= 0.5
        found.append(_statement(claim, "holds" if holds else "fails", ", ".join(dict.fromkeys(gaits))))
    return found


def stability_statements(content: dict[str, Any]) -> list[dict[str, str]]:
    """Whether training succeeds on more seeds with the first variant, the preset as it is, than with each other one.

    Open where the 95 % intervals of the shares overlap.
    """
    found = []
    first, *others = content["variants"]
    for ground in content["protocol"]["grounds"]:
        counts = {name: successes(content, ground, name) for name in content["variants"]}
        for name in others:
            (ours, tried), (theirs, tried_there) = counts[first], counts[name]
            if not tried or not tried_there:
                continue
            mine, other = wilson_interval(ours, tried), wilson_interval(theirs, tried_there)
            verdict = "holds" if mine[0] > other[1] else "fails" if mine[1] < other[0] else "open"
            why = f"{ours} of {tried} seeds against {theirs} of {tried_there}"
            found.append(_statement(f"{ground}: better than with {content['variants'][name]}", verdict, why))
    return found


def successes(content: dict[str, Any], ground: str, variant: str) -> tuple[int, int]:
    """How many seeds of a variant reached the goal, and how many were trained."""
    runs = [run for run in content["runs"] if (run["ground"], run["variant"]) == (ground, variant)]
    return sum(run["success"] >= content["protocol"]["goal"] for run in runs), len(runs)


def _statement(claim: str, verdict: str, why: str) -> dict[str, str]:
    return {"claim": claim, "verdict": verdict, "why": why}
