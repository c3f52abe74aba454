"""The losses' mathematics against numbers worked out by hand."""

import math

import pytest
import torch

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import make_pose
from torchgrasp.objectives.functional import (
    action_distance,
    goal_distance,
    masked_mean,
    pose_distance,
)

IDENTITY = torch.eye(4)
HALF_TURN = make_pose(torch.diag(torch.tensor([-1.0, -1.0, 1.0])), torch.zeros(3))
QUARTER_TURN = make_pose(torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), torch.zeros(3))


def test_translations_count_in_full():
    moved = IDENTITY.clone()
    moved[:3, 3] = torch.tensor([0.03, -0.04, 0.0])
    assert pose_distance(IDENTITY, moved).item() == pytest.approx(0.07)
    assert pose_distance(IDENTITY, moved, norm="l2").item() == pytest.approx(0.05)


def test_a_half_turn_about_the_approach():
    """Four of six points lie 0.053 m off the axis and move by twice that: 4 * 0.106 / 6."""
    assert pose_distance(IDENTITY, HALF_TURN).item() == pytest.approx(4 * 0.106 / 6)


def test_a_quarter_turn_in_both_norms():
    """Each of the four moves by 0.053 in x and in y."""
    assert pose_distance(IDENTITY, QUARTER_TURN).item() == pytest.approx(4 * 0.106 / 6)
    assert pose_distance(IDENTITY, QUARTER_TURN, norm="l2").item() == pytest.approx(
        4 * 0.053 * math.sqrt(2) / 6
    )


def test_own_points():
    assert pose_distance(IDENTITY, HALF_TURN, torch.tensor([[1.0, 2.0, 3.0]])).item() == pytest.approx(6.0)


def test_actions_and_goals_measure_the_same_poses():
    turn = torch.tensor([0.0, 0, 0, 0, 0, math.pi / 2])
    assert action_distance(torch.zeros(6), turn).item() == pytest.approx(4 * 0.106 / 6)
    rest = torch.tensor([0.0, 0, 0, 0, 0, 0, 1])
    half = math.sqrt(0.5)
    goal = torch.tensor([0.0, 0, 0, 0, 0, half, half])
    assert goal_distance(rest, goal).item() == pytest.approx(4 * 0.106 / 6)
    assert goal_distance(goal, -goal * torch.tensor([-1.0] * 3 + [1] * 4)).item() == pytest.approx(
        0, abs=1e-6
    )


def test_pose_distance_is_a_symmetric_distance_over_any_batch():
    generator = torch.Generator().manual_seed(0)
    a, b, c = (0.3 * torch.randn(2, 5, 6, generator=generator) for _ in range(3))
    assert action_distance(a, b).shape == (2, 5)
    assert torch.equal(action_distance(a, a), torch.zeros(2, 5))
    torch.testing.assert_close(action_distance(a, b), action_distance(b, a))
    assert (action_distance(a, c) <= action_distance(a, b) + action_distance(b, c) + 1e-6).all()


def test_gradients_lead_downhill():
    goal = torch.tensor([0.1, 0, 0.2, 0, 0, 0, 1])
    guess = torch.tensor([0.0, 0, 0, 0.1, 0.1, 0, 1], requires_grad=True)
    before = goal_distance(goal, guess)
    before.backward()
    assert guess.grad is not None
    assert goal_distance(goal, guess - 0.01 * guess.grad) < before


@pytest.mark.parametrize(("distance", "size"), [(action_distance, 6), (goal_distance, 7)])
def test_vectors_of_another_size_are_refused(distance, size):
    for shapes in (((2, size), (2, 1)), ((2, 3), (2, size)), ((2, size + 1),) * 2):
        with pytest.raises(ConfigError, match="distance="):
            distance(*map(torch.zeros, shapes))


def test_a_label_keeps_its_digits_beside_a_coarse_prediction():
    """0.0301 m is 0.0300 m in bfloat16: the distance to 0 is that of the label in full."""
    label = torch.tensor([0.0301, 0, 0, 0, 0, 0])
    found = action_distance(label, torch.zeros(6, dtype=torch.bfloat16))
    assert found.dtype == torch.float32
    assert found.item() == pytest.approx(0.0301, rel=1e-4)


def test_weighted_mean():
    """(1 * 2 + 3 * 6) / (1 + 3), the masked value of weight 5 left out."""
    values, weights = torch.tensor([2.0, 6.0, torch.nan]), torch.tensor([1.0, 3.0, 5.0])
    assert masked_mean(values, torch.tensor([True, True, False]), weights).item() == 5.0


def test_masked_mean():
    values = torch.tensor([1.0, 2.0, 6.0], requires_grad=True)
    masked_mean(values, torch.tensor([True, False, True])).backward()
    assert values.grad is not None
    assert values.grad.tolist() == [0.5, 0.0, 0.5]
    assert masked_mean(values).item() == 3.0


def test_an_empty_mask_gives_zero_with_its_graph():
    values = torch.tensor([1.0, torch.nan], requires_grad=True)
    mean = masked_mean(values, torch.tensor([False, False]))
    mean.backward()
    assert mean.item() == 0.0
    assert values.grad is not None
    assert values.grad.tolist() == [0.0, 0.0]
