"""Shares of a batch: how many rows each source gives, exactly, in every batch."""

from __future__ import annotations

import math
from collections.abc import Mapping

from torchgrasp.errors import ConfigError


def check_shares(shares: Mapping[str, float]) -> dict[str, float]:
    """Return `shares` as floats, or raise ConfigError unless they are >= 0 and add up to 1."""
    if not shares:
        raise ConfigError('shares={} names no source: give for example {"online": 0.7, "expert": 0.3}.')
    values = {str(name): float(share) for name, share in shares.items()}
    for name, share in values.items():
        if not 0.0 <= share <= 1.0:
            raise ConfigError(f"shares[{name!r}]={share} is out of range: give a value in [0, 1].")
    total = math.fsum(values.values())
    if abs(total - 1.0) > 1e-6:
        raise ConfigError(f"shares={values} add up to {total:g}: scale them so that they add up to 1.")
    return values


def split_batch(batch_size: int, shares: Mapping[str, float]) -> dict[str, int]:
    """Rows per source that add up to `batch_size`: largest remainders, ties to the source named first.

    Shares are relative: leaving out a source that has no data gives its rows to the others in proportion.

    >>> split_batch(250, {"online": 0.7, "expert": 0.3})
    {'online': 175, 'expert': 75}
    >>> split_batch(128, {"online": 0.7, "expert": 0.3})
    {'online': 90, 'expert': 38}
    """
    total = math.fsum(shares.values())
    # Rounded to 1e-9 so that 250 * 0.7 = 174.99999999999997 counts as 175.
    exact = {name: round(batch_size * share / total, 9) for name, share in shares.items()}
    counts = {name: math.floor(rows) for name, rows in exact.items()}
    by_remainder = sorted(exact, key=lambda name: counts[name] - exact[name])
    for name in by_remainder[: batch_size - sum(counts.values())]:
        counts[name] += 1
    return counts


def share_batch(own: str, fraction: float, weights: Mapping[str, float]) -> dict[str, float]:
    """Shares of a batch: `fraction` for the source `own`, the rest for the others by weight.

    >>> share_batch("online", 0.75, {"expert": 100, "failed": 300})
    {'online': 0.75, 'expert': 0.0625, 'failed': 0.1875}
    """
    total = sum(weights.values())
    return {own: fraction, **{name: (1.0 - fraction) * each / total for name, each in weights.items()}}


def anneal_shares(start: Mapping[str, float], end: Mapping[str, float], progress: float) -> dict[str, float]:
    """Shares on the straight line from `start` (progress <= 0) to `end` (progress >= 1).

    >>> anneal_shares({"online": 0.5, "expert": 0.5}, {"online": 1.0, "expert": 0.0}, 0.5)
    {'online': 0.75, 'expert': 0.25}
    """
    first, last = check_shares(start), check_shares(end)
    if first.keys() != last.keys():
        raise ConfigError(
            f"shares of {sorted(first)} cannot turn into {sorted(last)}: name the same sources."
        )
    weight = min(max(progress, 0.0), 1.0)
    return {name: (1.0 - weight) * first[name] + weight * last[name] for name in first}
