"""Intervals of rates, of means and of differences: over episodes (Wilson, Newcombe) and over seeds (t).

scipy.stats is imported where it is used: it takes longer to import than the rest of the package.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from torchgrasp.errors import ConfigError

Interval = tuple[float, float]


def wilson_interval(successes: int, n: int, confidence: float = 0.95) -> Interval:
    """(low, high) of Wilson's score interval for a success rate; (0, 1) where nothing was tried.

    >>> [round(bound, 3) for bound in wilson_interval(264, 272)]
    [0.943, 0.985]
    """
    from scipy.stats import binomtest

    if n == 0:
        return 0.0, 1.0
    found = binomtest(successes, n).proportion_ci(confidence, method="wilson")
    return float(found.low), float(found.high)


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> Interval:
    """Student's t interval of a mean of R values, R - 1 degrees of freedom.

    Of per-seed differences it is the paired interval: what the seeds share cancels.

    >>> [round(bound, 3) for bound in mean_interval([0.1, 0.2, 0.3])]
    [-0.048, 0.448]
    """
    from scipy.stats import ttest_1samp

    _need_two(values)
    with _equal_values_allowed():
        found = ttest_1samp(np.asarray(values), 0.0).confidence_interval(confidence)
    return float(found.low), float(found.high)


def welch_interval(values: Sequence[float], base: Sequence[float], confidence: float = 0.95) -> Interval:
    """Welch's (1947) interval of the mean of `values` minus that of `base`, of unequal variances."""
    from scipy.stats import ttest_ind

    _need_two(values)
    _need_two(base)
    with _equal_values_allowed():
        test = ttest_ind(np.asarray(values), np.asarray(base), equal_var=False)
        found = test.confidence_interval(confidence)
    return float(found.low), float(found.high)


def newcombe_interval(
    successes: int, n: int, base_successes: int, base_n: int, confidence: float = 0.95
) -> Interval:
    """Newcombe's hybrid score interval of a success rate minus another (Newcombe 1998, method 10).

    Every episode counts as independent of the others: the interval knows nothing of seeds. scipy has no
    interval of a difference of two proportions.

    >>> [round(bound, 4) for bound in newcombe_interval(56, 70, 48, 80)]
    [0.0524, 0.3339]
    """
    rate, base = (k / m if m else 0.5 for k, m in ((successes, n), (base_successes, base_n)))
    low, high = wilson_interval(successes, n, confidence)
    base_low, base_high = wilson_interval(base_successes, base_n, confidence)
    below = math.hypot(rate - low, base_high - base)
    above = math.hypot(high - rate, base - base_low)
    return rate - base - below, rate - base + above


def paired_interval(gained: int, lost: int, n: int, confidence: float = 0.95) -> Interval:
    """Interval of the difference of two success rates over the same n scenes (Agresti and Min 2005).

    It is Wald's with half a scene more of each kind. Scenes in which both succeed or both fail tell nothing
    of the difference, so that it is narrower than one of independent episodes.

    Args:
        gained: scenes in which the first alone succeeds.
        lost: scenes in which the second alone does.
        n: all scenes; (-1, 1) without any.
        confidence: of the interval.

    >>> [round(bound, 4) for bound in paired_interval(17, 5, 280)]
    [0.0096, 0.0755]
    """
    from scipy.stats import norm

    if n == 0:
        return -1.0, 1.0
    first, second, total = gained + 0.5, lost + 0.5, n + 2.0
    middle = (first - second) / total
    spread = math.sqrt(first + second - (first - second) ** 2 / total) / total
    reach = float(norm.ppf(0.5 + confidence / 2)) * spread
    return max(-1.0, middle - reach), min(1.0, middle + reach)


@contextmanager
def _equal_values_allowed() -> Iterator[None]:
    """Without scipy's warning that the p-value, which nobody asks for, is unreliable for equal values."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _need_two(values: Sequence[float]) -> None:
    if len(values) < 2:
        raise ConfigError(f"An interval over {len(values)} run(s): give at least two seeds.")
