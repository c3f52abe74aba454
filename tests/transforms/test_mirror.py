"""The hand's symmetries leave what is geometry alone."""

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.geometry import (
    action_to_pose,
    goal_to_pose,
    gripper_control_points,
    pose_to_goal,
    transform_points,
)
from torchgrasp.objectives.functional import action_distance, goal_distance
from torchgrasp.transforms import RandomMirror

N = 200


@pytest.fixture
def sample() -> TensorDict:
    g = torch.Generator().manual_seed(0)
    action, other = (torch.rand(N, 6, generator=g) - 0.5 for _ in range(2))
    goal = pose_to_goal(action_to_pose(torch.rand(N, 6, generator=g) - 0.5))
    points = torch.rand(N, 9, 4, generator=g)
    after = {"points": points + 1.0}
    return TensorDict(
        {"points": points, "action": action, "expert_action": other, "goal": goal, "next": after}, [N]
    )


def mirrored(sample: TensorDict) -> tuple[TensorDict, torch.Tensor]:
    """The mirrored sample and the (N, 3) signs that it was given."""
    out = RandomMirror(generator=torch.Generator().manual_seed(1))(sample.clone())
    return out, (out["points"][:, 0, :3] / sample["points"][:, 0, :3]).round()


def test_all_four_reflections_occur_evenly(sample):
    _, signs = mirrored(sample)
    assert torch.all(signs[:, 2] == 1.0)
    counts = signs[:, :2].unique(dim=0, return_counts=True)[1]
    assert len(counts) == 4 and counts.min() > N / 8


def test_state_and_next_state_get_the_same_reflection(sample):
    out, signs = mirrored(sample)
    assert torch.allclose(out["next", "points"][..., :3], sample["next", "points"][..., :3] * signs[:, None])
    assert torch.equal(out["points"][..., 3], sample["points"][..., 3])


@pytest.mark.parametrize("key, to_pose", [("action", action_to_pose), ("goal", goal_to_pose)])
def test_poses_move_mirrored_points_as_the_mirror_of_what_they_moved(sample, key, to_pose):
    out, signs = mirrored(sample)
    points = torch.rand(N, 5, 3)
    moved = transform_points(to_pose(sample[key]), points) * signs[:, None]
    assert torch.allclose(transform_points(to_pose(out[key]), points * signs[:, None]), moved, atol=1e-5)


def test_distances_between_poses_stay(sample):
    out, _ = mirrored(sample)
    before, after = (action_distance(s["action"], s["expert_action"]) for s in (sample, out))
    assert torch.allclose(before, after, atol=1e-5)
    origin = torch.tensor([0, 0, 0, 0, 0, 0, 1.0]).expand(N, 7)
    assert torch.allclose(
        goal_distance(sample["goal"], origin), goal_distance(out["goal"], origin), atol=1e-5
    )


def test_the_hand_is_its_own_mirror_image():
    points = gripper_control_points()
    for sign in ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0)):
        reflected = points * torch.tensor(sign)
        assert all((points - row).abs().sum(-1).min() < 1e-7 for row in reflected)


def test_goals_keep_their_quaternions_sign(sample):
    out, _ = mirrored(sample)
    assert torch.all(out["goal"][:, 6] >= 0)
