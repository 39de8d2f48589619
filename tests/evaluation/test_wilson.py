"""Wilson's interval, against published values."""

import math

import numpy as np
import pytest

from arrive.evaluation.wilson import wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "interval"),
    [(0, 10, (0.0, 0.2775)), (10, 10, (0.7225, 1.0)), (50, 100, (0.4038, 0.5962)), (81, 263, (0.2553, 0.3662))],
)
def test_wilson_gives_published_values(successes, trials, interval):
    """The last row is from Newcombe (1998), Statistics in Medicine 17, 857, table I."""
    assert wilson_interval(successes, trials) == pytest.approx(interval, abs=5e-5)


def test_wilson_covers_the_true_share_at_the_stated_confidence():
    trials = 100
    intervals = [wilson_interval(successes, trials) for successes in range(trials + 1)]

    def coverage(share: float) -> float:
        chances = [math.comb(trials, k) * share**k * (1 - share) ** (trials - k) for k in range(trials + 1)]
        return sum(chance for chance, (low, high) in zip(chances, intervals, strict=True) if low <= share <= high)

    covered = [coverage(share) for share in np.linspace(0.05, 0.95, 181)]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.005)
    assert min(covered) > 0.91


@pytest.mark.parametrize("measurement", [(1, 0, 0.95), (-1, 10, 0.95), (11, 10, 0.95), (5, 10, 1.0), (5, 10, 0.0)])
def test_wilson_refuses_nonsense(measurement):
    with pytest.raises(ValueError, match=r"measurement|confidence"):
        wilson_interval(*measurement)
