"""Physics that is fixed or drawn: ranges, bounds, independence."""

import numpy as np
import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.sim import Physics


def test_what_varies_is_drawn_within_its_range_and_the_rest_stays():
    physics = Physics(friction=0.7, vary={"mass": [0.1, 0.3], "finger_force": (20.0, 20.0)})
    drawn = [physics.draw(np.random.default_rng(i)) for i in range(200)]
    masses = np.array([each.mass for each in drawn])
    assert 0.1 <= masses.min() < 0.11 and 0.29 < masses.max() <= 0.3
    assert {each.friction for each in drawn} == {0.7} and {each.finger_force for each in drawn} == {20.0}
    assert all(not each.vary for each in drawn)
    assert physics.draw(np.random.default_rng(3)) == drawn[3]


def test_null_does_not_vary():
    assert Physics(vary={"mass": None}) == Physics()  # type: ignore[dict-item]


def test_the_order_of_the_ranges_changes_no_draw():
    pairs = {"mass": (0.1, 0.3), "friction": (0.5, 1.0)}
    first = Physics(vary=pairs).draw(np.random.default_rng(0))
    assert Physics(vary=dict(reversed(pairs.items()))).draw(np.random.default_rng(0)) == first


@pytest.mark.parametrize(
    ("vary", "word"),
    [
        ({"lift_height": (0.1, 0.2)}, "lift_height"),
        ({"mass": (0.3, 0.1)}, "mass"),
        ({"mass": (0.1,)}, "low, high"),
        ({"mass": (0.0, 0.1)}, r"^vary\['mass'\]\[0\]=0.0"),
        ({"friction": (-1.0, 0.1)}, r"^vary\['friction'\]\[0\]=-1.0"),
        ({"mass": 0.3}, "low, high"),
        ({"mass": (0.1, float("inf"))}, "low, high"),
        ({"mass": ("a", 1)}, "low, high"),
    ],
)
def test_impossible_ranges_are_refused_by_name(vary, word):
    with pytest.raises(ConfigError, match=word):
        Physics(vary=vary)
