import math

import numpy as np
import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.intervals import (
    mean_interval,
    newcombe_interval,
    paired_interval,
    welch_interval,
    wilson_interval,
)


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        # Computed by hand from the formula with z = 1.959964.
        (5, 10, 0.2366, 0.7634),
        (81, 100, 0.7222, 0.8749),
        (0, 10, 0.0, 0.2775),
        (10, 10, 0.7225, 1.0),
        (0, 0, 0.0, 1.0),
    ],
)
def test_wilson_interval_against_known_values(successes, n, low, high):
    assert wilson_interval(successes, n) == pytest.approx((low, high), abs=1e-4)


@pytest.mark.parametrize("n", [1, 7, 200, 33_333])
def test_wilson_interval_ends_exactly_where_all_or_none_succeeded(n):
    assert wilson_interval(0, n)[0] == 0.0 and wilson_interval(n, n)[1] == 1.0


def test_wilson_interval_is_symmetric_and_widens_with_confidence():
    low, high = wilson_interval(3, 20)
    assert wilson_interval(17, 20) == pytest.approx((1 - high, 1 - low))
    wide = wilson_interval(3, 20, confidence=0.99)
    assert wide[0] < low < 3 / 20 < high < wide[1]


@pytest.mark.parametrize(
    ("counts", "low", "high"),
    [  # Newcombe 1998, Table II, method 10
        ((56, 70, 48, 80), 0.0524, 0.3339),
        ((9, 10, 3, 10), 0.1705, 0.8090),
        ((6, 7, 2, 7), 0.0582, 0.8062),
        ((5, 56, 0, 29), -0.0381, 0.1926),
        ((0, 10, 0, 20), -0.1611, 0.2775),
        ((10, 10, 0, 10), 0.6075, 1.0),
    ],
)
def test_newcombes_own_examples(counts, low, high):
    assert newcombe_interval(*counts) == pytest.approx((low, high), abs=6e-5)


def test_changing_sides_changes_the_sign():
    low, high = newcombe_interval(3, 40, 11, 25)
    assert newcombe_interval(11, 25, 3, 40) == pytest.approx((-high, -low))
    low, high = welch_interval([0.1, 0.4], [0.3, 0.35, 0.2])
    assert welch_interval([0.3, 0.35, 0.2], [0.1, 0.4]) == pytest.approx((-high, -low))


def test_where_nothing_was_tried_nothing_is_known():
    low, high = newcombe_interval(0, 0, 0, 0)
    assert low == pytest.approx(-math.sqrt(0.5)) and high == pytest.approx(math.sqrt(0.5))


def test_students_interval_by_hand():
    # t(0.975, 2) = 4.302653, s = 0.1, so 0.2 ± 4.302653 * 0.1 / sqrt(3)
    assert mean_interval([0.1, 0.2, 0.3]) == pytest.approx((0.2 - 0.248414, 0.2 + 0.248414), abs=1e-6)
    # t(0.95, 1) = 6.313752
    assert mean_interval([0.0, 2.0], confidence=0.9) == pytest.approx((1 - 6.313752, 1 + 6.313752), abs=1e-6)


def test_welchs_interval_by_hand():
    # Equal variances and sizes: 2 (n - 1) = 4 degrees, t(0.975, 4) = 2.776445, both s² / n = 1 / 3.
    half = 2.776445 * math.sqrt(2 / 3)
    assert welch_interval([1.0, 2.0, 3.0], [5.0, 6.0, 7.0]) == pytest.approx((-4 - half, -4 + half), abs=1e-5)


def test_equal_values_have_an_interval_without_width_and_no_warning(recwarn):
    assert welch_interval([0.5, 0.5], [0.25, 0.25, 0.25]) == (0.25, 0.25)
    assert mean_interval([0.5, 0.5]) == (0.5, 0.5)
    low, high = welch_interval([0.5, 0.5], [0.25, 0.35])  # one degree of freedom: t(0.975, 1) = 12.706205
    assert (low, high) == pytest.approx((0.2 - 12.706205 * 0.05, 0.2 + 12.706205 * 0.05), abs=1e-6)
    assert not recwarn.list


@pytest.mark.parametrize("values", [[], [0.5]])
def test_one_run_has_no_interval(values):
    with pytest.raises(ConfigError, match="two seeds"):
        mean_interval(values)
    with pytest.raises(ConfigError, match="two seeds"):
        welch_interval([0.1, 0.2], values)


def test_the_paired_interval_against_hand_and_its_limits():
    # Half a scene more of each of the four kinds: (53.5, 26.5) of 702, by the formula with z = 1.959964.
    assert paired_interval(53, 26, 700) == pytest.approx((0.013652, 0.063271), abs=1e-5)
    assert paired_interval(0, 0, 0) == (-1.0, 1.0) and paired_interval(3, 3, 10)[1] == pytest.approx(
        -paired_interval(3, 3, 10)[0]
    )
    assert paired_interval(10, 0, 10)[1] <= 1.0


def test_the_paired_interval_holds_the_difference_as_often_as_it_says():
    """Over 2,000 draws of 200 scenes, in which 6 % are gained and 2 % are lost."""
    rng = np.random.default_rng(0)
    draws = rng.multinomial(200, [0.06, 0.02, 0.92], size=2000)
    held = [low <= 0.04 <= high for low, high in (paired_interval(a, b, 200) for a, b, _ in draws)]
    assert 0.93 < np.mean(held) < 0.98


def test_the_paired_interval_is_narrower_than_that_of_independent_episodes():
    low, high = paired_interval(17, 5, 280)
    wide_low, wide_high = newcombe_interval(250, 280, 238, 280)
    assert high - low < 0.7 * (wide_high - wide_low)
