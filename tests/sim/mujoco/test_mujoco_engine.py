"""The numbers of MuJoCo's contacts: what is refused, and what reaches the model."""

import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.sim import MujocoEngine


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"substeps": 0}, r"^substeps=0"),
        ({"softness": 0.0}, r"^softness=0.0"),
        ({"impratio": -1.0}, r"^impratio=-1.0"),
        ({"noslip_iterations": 1.5}, r"^noslip_iterations=1.5"),
        ({"condim": 5}, r"^condim=5 is unknown: give 3, 4 or 6"),
        ({"torsion": -0.1}, r"^torsion=-0.1"),
        ({"impedance": (0.9,)}, r"^impedance=.* is no pair"),
        ({"impedance": (0.9, 1.5)}, r"^impedance\[1\]=1.5"),
    ],
)
def test_impossible_numbers_are_refused_by_name(options, told):
    with pytest.raises(ConfigError, match=told):
        MujocoEngine(**options)


def test_lists_of_a_configuration_are_pairs():
    assert MujocoEngine(impedance=[0.9, 0.95]) == MujocoEngine(impedance=(0.9, 0.95))
