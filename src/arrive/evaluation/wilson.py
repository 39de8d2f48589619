"""The confidence interval of a measured share, such as the arrival rate of an evaluation."""

from math import sqrt
from statistics import NormalDist


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval that covers the true share of successes in about `confidence` of all repetitions.

    With p = successes / trials, n = trials and z the normal quantile of 1 - (1 - confidence) / 2, its ends are

        (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

    (E. B. Wilson, 1927, J. Am. Stat. Assoc. 22, 209). Unlike p -+ z sqrt(p (1 - p) / n) it stays within 0 and 1 and
    has a sensible width at 0 and at 100 %.

    Returns:
        Lower and upper end, each from 0 to 1.

    Raises:
        ValueError: no trials, more successes than trials, a negative count, or a confidence outside (0, 1).
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials is no measurement")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence must lie between 0 and 1, not {confidence}")
    z = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    share, z_sq = successes / trials, z * z
    center = share + z_sq / (2 * trials)
    half_width = z * sqrt(share * (1 - share) / trials + z_sq / (4 * trials**2))
    scale = 1 + z_sq / trials
    # Exact ends where rounding would leave -1e-17 or 0.9999999999999999.
    lower = 0.0 if successes == 0 else (center - half_width) / scale
    upper = 1.0 if successes == trials else (center + half_width) / scale
    return lower, upper
