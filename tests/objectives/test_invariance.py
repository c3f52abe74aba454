"""L_POSE as a distance of poses: its axioms, what leaves it unchanged, and its derivatives."""

import functools
import math

import pytest
import torch
from torch.autograd import gradcheck

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose, goal_to_pose, make_pose, transform_points
from torchgrasp.objectives import PoseBCLoss
from torchgrasp.objectives.functional import (
    action_distance,
    goal_distance,
    pose_distance,
)

NORMS = pytest.mark.parametrize("norm", ["l1", "l2"])
DISTANCES = pytest.mark.parametrize(("distance", "size"), [(action_distance, 6), (goal_distance, 7)])


def _random(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 0.4 * torch.randn(*shape, generator=generator, dtype=torch.float64)


def _poses(count, seed=0):
    return action_to_pose(_random(count, 6, seed=seed))


def _rotations(count):
    return make_pose(_poses(count, seed=9)[:, :3, :3], torch.zeros(count, 3, dtype=torch.float64))


@NORMS
def test_a_common_translation_changes_nothing(norm):
    a, b, shift = _poses(50), _poses(50, seed=1), torch.eye(4, dtype=torch.float64).repeat(50, 1, 1)
    shift[:, :3, 3] = _random(50, 3, seed=2)
    torch.testing.assert_close(pose_distance(shift @ a, shift @ b, norm=norm), pose_distance(a, b, norm=norm))


def test_a_common_rotation_changes_nothing_under_l2():
    a, b, turn = _poses(50), _poses(50, seed=1), _rotations(50)
    torch.testing.assert_close(pose_distance(turn @ a, turn @ b, norm="l2"), pose_distance(a, b, norm="l2"))


def test_a_common_rotation_can_change_l1():
    """10 cm along x are 10 cm; turned by 45 degrees about z they are 7.07 cm along x and along y."""
    here, there = torch.eye(4), torch.eye(4)
    there[0, 3] = 0.1
    half = math.sqrt(0.5)
    turn = make_pose(torch.tensor([[half, -half, 0.0], [half, half, 0.0], [0.0, 0.0, 1.0]]), torch.zeros(3))
    assert pose_distance(here, there).item() == pytest.approx(0.1)
    assert pose_distance(turn @ here, turn @ there).item() == pytest.approx(0.1 * math.sqrt(2))
    assert pose_distance(turn @ here, turn @ there, norm="l2").item() == pytest.approx(0.1)


@NORMS
def test_axioms_of_a_distance(norm):
    distance = functools.partial(pose_distance, norm=norm)
    a, b, c = (_poses(200, seed=seed) for seed in range(3))
    assert torch.equal(distance(a, a), torch.zeros(200, dtype=torch.float64))
    assert (distance(a, b) > 0).all()
    torch.testing.assert_close(distance(a, b), distance(b, a))
    assert (distance(a, c) <= distance(a, b) + distance(b, c) + 1e-12).all()


@NORMS
def test_only_equal_poses_have_distance_zero(norm):
    """X_g spans a plane, and no rotation but the identity keeps a plane: each axis shows."""
    here = torch.eye(4, dtype=torch.float64)
    for axis in range(6):
        moved = torch.zeros(6, dtype=torch.float64)
        moved[axis] = 0.1
        assert pose_distance(here, action_to_pose(moved), norm=norm) > 1e-3


@NORMS
def test_the_sign_and_the_length_of_a_quaternion_do_not_count(norm):
    a, b = _random(50, 7), _random(50, 7, seed=1)
    expected = goal_distance(a, b, norm=norm)
    for factor in (-1.0, 3.0):
        other = torch.cat((b[:, :3], factor * b[:, 3:]), dim=-1)
        torch.testing.assert_close(goal_distance(a, other, norm=norm), expected)


def test_l2_is_at_most_l1_and_l1_at_most_root_three_times_l2():
    a, b = _poses(200), _poses(200, seed=1)
    l1, l2 = (pose_distance(a, b, norm=norm) for norm in ("l1", "l2"))
    assert (l2 <= l1).all()
    assert (l1 <= math.sqrt(3) * l2).all()


@NORMS
@DISTANCES
def test_derivatives_of_distances(distance, size, norm):
    """Random poses: no coordinate of two points is equal, so that no kink is near."""
    given = (_random(4, size).requires_grad_(), _random(4, size, seed=1).requires_grad_())
    assert gradcheck(functools.partial(distance, norm=norm), given)


@NORMS
def test_derivatives_of_pose_distance(norm):
    given = tuple(_poses(3, seed=seed).requires_grad_() for seed in range(2))
    assert gradcheck(functools.partial(pose_distance, norm=norm), given)


def test_derivatives_of_conversions():
    assert gradcheck(action_to_pose, _random(3, 6).requires_grad_())
    assert gradcheck(goal_to_pose, _random(3, 7).requires_grad_())
    assert gradcheck(transform_points, (_poses(3).requires_grad_(), _random(3, 5, 3).requires_grad_()))


@NORMS
@DISTANCES
def test_at_zero_distance_the_gradient_is_zero(distance, size, norm):
    here = torch.zeros(1, size)
    here[:, -1] = 0.1
    here.requires_grad_()
    distance(here.detach().clone(), here, norm=norm).sum().backward()
    assert torch.equal(here.grad, torch.zeros(1, size))


def test_the_norm_of_a_loss_is_that_of_its_distance(constant_actor, batch):
    """3 and 4 cm: 7 cm under L1, 5 cm under L2."""
    batch["expert_action"] = torch.tensor([0.03, -0.04, 0.0, 0.0, 0.0, 0.0]).expand(4, 6)
    for norm, expected in (("l1", 0.07), ("l2", 0.05)):
        loss = PoseBCLoss(constant_actor(), distance=functools.partial(action_distance, norm=norm))
        assert loss(batch)["loss_bc"].item() == pytest.approx(expected)


def test_an_unknown_norm_is_refused():
    with pytest.raises(ConfigError, match="l3"):
        pose_distance(torch.eye(4), torch.eye(4), norm="l3")
