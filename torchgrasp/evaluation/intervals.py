"""Intervals of means and of differences, over seeds (t) and over episodes (Newcombe)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from scipy.stats import t as student

from torchgrasp.errors import ConfigError

Interval = tuple[float, float]


def wilson_interval(successes: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """(low, high) of Wilson's score interval for a success rate; (0, 1) where nothing was tried.

    >>> [round(bound, 3) for bound in wilson_interval(264, 272)]
    [0.943, 0.985]
    """
    if n == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    rate = successes / n
    centre = (rate + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    # Exactly 0 and 1 at the ends, where rounding would leave a residue.
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    return low, 1.0 if successes == n else min(1.0, centre + half)


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> Interval:
    """Student's t interval of a mean of R values, R - 1 degrees of freedom.

    Of per-seed differences it is the paired interval: what the seeds share cancels.

    >>> [round(bound, 3) for bound in mean_interval([0.1, 0.2, 0.3])]
    [-0.048, 0.448]
    """
    _need_two(values)
    half = float(student.ppf(0.5 + confidence / 2, len(values) - 1)) * _standard_error(values)
    return float(np.mean(values)) - half, float(np.mean(values)) + half


def welch_interval(values: Sequence[float], base: Sequence[float], confidence: float = 0.95) -> Interval:
    """Welch's (1947) interval of the mean of `values` minus that of `base`, of unequal variances."""
    _need_two(values)
    _need_two(base)
    parts = [_standard_error(each) ** 2 for each in (values, base)]
    difference, total = float(np.mean(values) - np.mean(base)), sum(parts)
    if total == 0.0:
        return difference, difference
    weights = [part**2 / (len(each) - 1) for part, each in zip(parts, (values, base), strict=True)]
    half = float(student.ppf(0.5 + confidence / 2, total**2 / sum(weights))) * math.sqrt(total)
    return difference - half, difference + half


def newcombe_interval(
    successes: int, n: int, base_successes: int, base_n: int, confidence: float = 0.95
) -> Interval:
    """Newcombe's hybrid score interval of a success rate minus another (Newcombe 1998, method 10).

    Every episode counts as independent of the others: the interval knows nothing of seeds.

    >>> [round(bound, 4) for bound in newcombe_interval(56, 70, 48, 80)]
    [0.0524, 0.3339]
    """
    rate, base = (k / m if m else 0.5 for k, m in ((successes, n), (base_successes, base_n)))
    low, high = wilson_interval(successes, n, confidence)
    base_low, base_high = wilson_interval(base_successes, base_n, confidence)
    below = math.hypot(rate - low, base_high - base)
    above = math.hypot(high - rate, base - base_low)
    return rate - base - below, rate - base + above


def _standard_error(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1)) / math.sqrt(len(values))


def _need_two(values: Sequence[float]) -> None:
    if len(values) < 2:
        raise ConfigError(f"An interval over {len(values)} run(s): give at least two seeds.")
