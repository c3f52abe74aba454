"""What a target weighs in PhysX."""

import numpy as np
import pytest

from torchgrasp.sim import Physics, Placement
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.sapien_world import SapienWorld


def find_body(target, mass):
    pose = np.eye(4)
    pose[:3, 3] = (0.5, 0.3, 0.5)
    return SapienWorld(Placement(target, pose, kin.READY_POSTURE, Physics(mass=mass)))._target


def test_every_object_weighs_what_physics_says(brick, can):
    for target in (brick, can):
        assert find_body(target, 0.3).mass == pytest.approx(0.3, rel=1e-5)
    a, b, c = 0.05, 0.06, 0.08
    expected = sorted([0.3 / 12 * (b * b + c * c), 0.3 / 12 * (a * a + c * c), 0.3 / 12 * (a * a + b * b)])
    assert sorted(find_body(brick, 0.3).inertia) == pytest.approx(expected, rel=1e-3)
