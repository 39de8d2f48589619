"""Means and ratios with their 95 % intervals, from the spread between robots."""

from math import sqrt
from statistics import NormalDist

from torch import Tensor

Z = NormalDist().inv_cdf(0.975)


def ratio(numerator: Tensor, denominator: Tensor) -> list[float] | None:
    """Ratio of two sums over robots with its interval, such as joules per metre.

    With R = sum(a) / sum(b) its variance is sum((a - R b)^2) / (n - 1) * n / sum(b)^2 to first order. Robots that
    walked farther count for more, as they should.

    Args:
        numerator, denominator: (n,) one value per robot.

    Returns:
        Ratio, lower and upper end; None of fewer than two robots.
    """
    n = len(numerator)
    if n < 2:
        return None
    a, b = numerator.double(), denominator.double()
    value = float(a.sum() / b.sum())
    error = sqrt(float((a - value * b).square().sum()) / (n - 1) * n) / abs(float(b.sum()))
    return [value, value - Z * error, value + Z * error]


def mean(values: Tensor) -> list[float] | None:
    """Mean of (n,) values, one per robot, with its interval; None of fewer than two."""
    return ratio(values, values.new_ones(len(values)))
