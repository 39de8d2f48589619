"""The paper's Table I beside our figures, and which of the paper's relations hold."""

import statistics
from collections.abc import Sequence
from typing import Any

from arrive.report.records import SYMBOLS, Run
from arrive.terrain import FAMILIES

PAPER: dict[str, dict[str, float | None]] = {
    "stairs": {"velocity": 0.22, "continuous": 0.20, "final": 0.40},
    "slope": {"velocity": 35.0, "continuous": 21.0, "final": 48.0},
    "steps": {"velocity": 0.14, "continuous": 0.16, "final": 0.20},
    "obstacles": {"velocity": 0.35, "continuous": None, "final": 0.85},
    "gap": {"velocity": 0.15, "continuous": 0.65, "final": 1.20},
    "pit": {"velocity": 0.10, "continuous": 0.65, "final": 0.95},
}
"""Maximum difficulty solved with 95 % success (paper, Table I); None where it reports a failure."""
LIMITS = ("max_at_95", "max_at_80", "max_at_50")
SCOPES = {"every terrain": 1.0, "at least half of the terrains": 0.5}
"""On which share of the terrains a claim must hold. The paper writes "on most terrains" of P_c above V, and its Table I
shows it on three of six."""
RELATIONS = (
    ("final", "velocity", "every terrain"),
    ("continuous", "velocity", "at least half of the terrains"),
    ("final", "continuous", "every terrain"),
)
"""The paper's claims: the first task solves harder terrain than the second, and where."""


def make_table(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """One row per family of the paper's table or measured here: the paper's figures, and each run's beside them."""
    measured = {family for run in runs for family in run.results()}
    names = [*PAPER, *(name for name in FAMILIES if name in measured and name not in PAPER)]
    return [
        {
            "family": name,
            "parameter": FAMILIES[name].parameter,
            "unit": FAMILIES[name].unit,
            "paper": PAPER.get(name),
            "ours": [_entry(run, name) for run in runs if name in run.results()],
        }
        for name in names
    ]


def _entry(run: Run, family: str) -> dict[str, Any]:
    content = run.families[family]
    episodes = [level["episodes"] for level in content["levels"]]
    return {
        "run": run.name,
        "task": run.task,
        "levels": len(episodes),
        "episodes": sum(episodes),
        "hardest": content["levels"][-1]["value"],
    } | {limit: content[limit] for limit in LIMITS}


def make_relations(table: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each of the paper's claims, as a whole and by family: `holds`, `fails` or `open`.

    A family is open where neither task solves any level. Several runs of one task stand for it by their median. Where
    both tasks solve the same at 95 %, or nothing, 80 and then 50 % decide. Families that do not measure both tasks are
    left out.
    """
    rows = []
    for better, worse, scope in RELATIONS:
        verdicts = {}
        for row in table:
            ours = {task: [entry for entry in row["ours"] if entry["task"] == task] for task in (better, worse)}
            if all(ours.values()) and row["unit"]:
                verdicts[row["family"]] = _compare(ours[better], ours[worse])
        claim = f"{SYMBOLS[better]} above {SYMBOLS[worse]} on {scope}"
        found = [verdict["verdict"] for verdict in verdicts.values()]
        rows.append({"claim": claim, "verdict": _overall(found, SCOPES[scope]), "families": verdicts})
    return rows


def _overall(verdicts: Sequence[str], share: float) -> str:
    """Whether a claim holds on this share of the measured families; open while the open ones can decide it."""
    count = len(verdicts)
    if count and verdicts.count("holds") >= share * count:
        return "holds"
    return "fails" if verdicts.count("fails") > (1.0 - share) * count else "open"


def _compare(better: list[dict[str, Any]], worse: list[dict[str, Any]]) -> dict[str, Any]:
    first, second = None, None
    for limit in LIMITS:
        first, second = _median(better, limit), _median(worse, limit)
        if first != second:
            higher = (-1.0 if first is None else first) > (-1.0 if second is None else second)
            return {"verdict": "holds" if higher else "fails", "by": limit, "values": [first, second]}
    if first is None:
        return {"verdict": "open", "by": LIMITS[-1], "values": [None, None]}
    return {"verdict": "fails", "by": LIMITS[-1], "values": [first, second]}


def _median(entries: list[dict[str, Any]], limit: str) -> float | None:
    """The lower median; None, nothing solved, is below every value."""
    value = statistics.median_low([-1.0 if entry[limit] is None else entry[limit] for entry in entries])
    return None if value < 0 else value
