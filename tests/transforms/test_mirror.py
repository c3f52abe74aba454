import pytest
import torch
from tensordict import TensorDict

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose, goal_to_pose, gripper_control_points, transform_points
from torchgrasp.transforms import RandomMirror

KINDS = {"action": action_to_pose, "goal": goal_to_pose}


def make_batch(n: int = 64) -> TensorDict:
    torch.manual_seed(0)
    goal = torch.cat((torch.randn(n, 3), torch.nn.functional.normalize(torch.randn(n, 4), dim=-1)), dim=-1)
    points = torch.cat((torch.randn(n, 9, 3), torch.zeros(n, 9, 1)), dim=-1)
    after = {"points": points + 1, "time_left": torch.rand(n, 1), "goal": goal.roll(1, dims=0)}
    action = 0.5 * torch.randn(n, 6)
    return TensorDict({"points": points, "action": action, "goal": goal, "next": after}, [n])


def mirrored(batch: TensorDict) -> tuple[TensorDict, torch.Tensor]:
    """The batch after the transform, and the (N, 3) signs that each element got."""
    out = RandomMirror(generator=torch.Generator().manual_seed(1))(batch.clone())
    return out, (out["points"][:, 0, :3] / batch["points"][:, 0, :3]).round()


def test_all_four_reflections_occur_and_z_stays():
    _, signs = mirrored(make_batch())
    assert {tuple(each.tolist()) for each in signs} == {(a, b, 1.0) for a in (-1.0, 1.0) for b in (-1.0, 1.0)}


def test_a_reflected_pose_moves_reflected_points_as_the_pose_moved_the_points():
    batch = make_batch()
    out, signs = mirrored(batch)
    points = torch.randn(len(batch), 5, 3)
    for key, to_pose in KINDS.items() | {(("next", "goal"), goal_to_pose)}:
        moved = transform_points(to_pose(batch[key]), points)
        again = transform_points(to_pose(out[key]), points * signs[:, None])
        assert torch.allclose(again, moved * signs[:, None], atol=1e-5)


def test_state_and_next_state_share_a_reflection_and_other_keys_stay():
    batch = make_batch()
    out, signs = mirrored(batch)
    assert torch.equal(out["next", "points"][..., :3], batch["next", "points"][..., :3] * signs[:, None])
    assert torch.equal(out["next", "time_left"], batch["next", "time_left"])


def test_the_hand_is_its_own_mirror_image():
    hand = gripper_control_points()
    for signs in ((1, -1, 1), (-1, 1, 1), (-1, -1, 1)):
        image = hand * torch.tensor(signs)
        assert torch.cdist(image, hand).amin(dim=-1).max() == 0


def test_that_there_is_no_goal_stays_so():
    batch = make_batch()
    out, _ = mirrored(batch.set("goal", torch.zeros(64, 7)))
    assert out["goal"].abs().max() == 0


def test_labels_are_not_mirrored_without_their_cloud():
    with pytest.raises(ConfigError, match="leave RandomMirror out"):
        RandomMirror()(TensorDict({"image": torch.rand(2, 3, 8, 8), "action": torch.rand(2, 6)}, [2]))
