"""Intervals and tests for success rates: the score interval and its paired relatives.

Every probability goes in as counts and comes out in percent (points for differences), since that
is how results are read; p-values stay in [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

Interval = tuple[float, float]


def wilson(successes: int, n: int, *, confidence: float = 0.95) -> Interval:
    """Wilson score interval of a success rate, in percent, inside [0, 100].

    Wilson (1927). Unlike the normal approximation it keeps its coverage near 0 and 100 %, and it is
    never of zero width: 0 of 100 gives [0, 3.7].

    Raises:
        ValueError: not `0 <= successes <= n` with `n >= 1`.
    """
    if not (n >= 1 and 0 <= successes <= n):
        raise ValueError(f"{successes} successes of {n} is no proportion")
    z = _normal_quantile(confidence)
    rate = successes / n
    scale = 1.0 + z * z / n
    centre = (rate + z * z / (2 * n)) / scale
    half = z / scale * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == n else min(1.0, centre + half)
    return 100.0 * low, 100.0 * high


def newcombe_paired(
    both: int, only_a: int, only_b: int, neither: int, *, confidence: float = 0.95
) -> Interval:
    """Interval of `rate(b) - rate(a)` in percentage points, from the counts of paired outcomes.

    Newcombe (1998), Stat. Med. 17:2635, method 10 ("square and add"): the two Wilson intervals
    joined through the correlation of the pairs. It never leaves [-100, 100] and has a width even
    when no pair disagrees.

    Raises:
        ValueError: a negative count, or no pair at all.
    """
    n = both + only_a + only_b + neither
    if min(both, only_a, only_b, neither) < 0 or n == 0:
        raise ValueError(f"no table of pairs: {(both, only_a, only_b, neither)}")
    in_a, in_b = both + only_a, both + only_b
    rate_a, rate_b = 100.0 * in_a / n, 100.0 * in_b / n
    low_a, high_a = wilson(in_a, n, confidence=confidence)
    low_b, high_b = wilson(in_b, n, confidence=confidence)
    phi = _pair_correlation(both, only_a, only_b, neither)
    down = _joined(rate_b - low_b, high_a - rate_a, phi)
    up = _joined(high_b - rate_b, rate_a - low_a, phi)
    difference = 100.0 * (only_b - only_a) / n
    return max(-100.0, difference - down), min(100.0, difference + up)


def mcnemar_exact(only_a: int, only_b: int) -> float:
    """Two-sided exact p-value that the discordant pairs fall on both sides alike (McNemar 1947)."""
    n = only_a + only_b
    tail = sum(math.comb(n, k) for k in range(min(only_a, only_b) + 1))
    return min(1.0, float(2 * tail / 2**n))


def mean(values: Sequence[float]) -> float | None:
    """Arithmetic mean, None of nothing. Summed exactly, so the order has no effect."""
    return math.fsum(values) / len(values) if values else None


def standard_deviation(values: Sequence[float]) -> float | None:
    """Sample standard deviation (n - 1), None of fewer than two values."""
    centre = mean(values)
    if centre is None or len(values) < 2:
        return None
    return math.sqrt(math.fsum((value - centre) ** 2 for value in values) / (len(values) - 1))


def t_interval(values: Sequence[float], *, confidence: float = 0.95) -> Interval | None:
    """Student-t interval of the mean of `values`, None of fewer than two values."""
    centre, deviation = mean(values), standard_deviation(values)
    if centre is None or deviation is None:
        return None
    from scipy.special import stdtrit

    quantile = float(stdtrit(len(values) - 1, 0.5 + confidence / 2))
    half = quantile * deviation / math.sqrt(len(values))
    return centre - half, centre + half


def _normal_quantile(confidence: float) -> float:
    """Two-sided normal quantile: 1.96 for 0.95."""
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence {confidence} is not between 0 and 1")
    return NormalDist().inv_cdf(0.5 + confidence / 2)


def _pair_correlation(both: int, only_a: int, only_b: int, neither: int) -> float:
    """Newcombe's continuity-corrected phi coefficient; 0 where a margin is empty."""
    n = both + only_a + only_b + neither
    margins = (both + only_a) * (only_b + neither) * (both + only_b) * (only_a + neither)
    if margins == 0:
        return 0.0
    cross = float(both * neither - only_a * only_b)
    if cross > 0:
        cross = max(cross - n / 2, 0.0)
    return cross / math.sqrt(margins)


def _joined(one: float, other: float, phi: float) -> float:
    """Length of the difference of two deviations with correlation `phi`."""
    return math.sqrt(max(0.0, one * one - 2 * phi * one * other + other * other))
