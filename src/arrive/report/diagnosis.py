"""Why a level is stuck, in a sentence per terrain family."""

from collections.abc import Sequence

from arrive.evaluation.arrival import CellResult

CAUSES = {
    "crash": "crashed",
    "fell": "fell into the hole",
    "wrong_side": "did not get across or around",
    "stalled": "stood still too early",
    "late": "were still on their way",
}
"""Descriptions of failures, by cause."""
WANTED = 0.95
LEAST_SHARE = 0.005
"""Rarer causes are not mentioned."""


def why_stuck(results: Sequence[CellResult]) -> str:
    """At which level of a family robots begin to fail and how, e.g. "gap: at 0.50 m 63 % succeed, 31 % fell ...".

    Args:
        results: of one family, easiest level first.
    """
    stuck = next((i for i, result in enumerate(results) if result.success < WANTED), None)
    family = results[0].cell.family.name
    if stuck is None:
        return f"{family}: at least {WANTED:.0%} at every level{_up_to(results[-1], results)}"
    result = results[stuck]
    before = f"at least {WANTED:.0%}{_up_to(results[stuck - 1], results)}; " if stuck else ""
    return f"{family}: {before}{_at(result, results)}{result.success:.1%} succeed, {how(result)}"


def how(result: CellResult) -> str:
    """Causes of the failures, most frequent first."""
    shares = {cause: count / result.episodes for cause, count in result.failures.items()}
    named = sorted((cause for cause in shares if shares[cause] >= LEAST_SHARE), key=lambda cause: -shares[cause])
    return ", ".join(f"{shares[cause]:.1%} {CAUSES.get(cause, cause)}" for cause in named)


def _value(result: CellResult) -> str:
    return f"{result.cell.value:.3g} {result.cell.family.unit}"


def _up_to(result: CellResult, results: Sequence[CellResult]) -> str:
    return f" up to {_value(result)}" if len(results) > 1 else ""


def _at(result: CellResult, results: Sequence[CellResult]) -> str:
    varies = result.cell.family.lowest != result.cell.family.highest
    return f"at {_value(result)} " if varies else ""
