import pytest
import torch
from tensordict import TensorDict

from torchgrasp.report.episode_pictures import FailurePictures, GraspPictures
from torchgrasp.rollouts.episode_pool import Episode


@pytest.mark.parametrize(
    ("reward", "sees_points", "pictures"), [(0.0, True, 6), (1.0, True, 0), (0.0, False, 0)]
)
def test_the_first_failures_that_points_show_are_drawn(reward, sees_points, pictures):
    state = {"T_base_ee": torch.eye(4).expand(2, 4, 4)}
    if sees_points:
        state["points"] = torch.rand(2, 8, 4).round(decimals=1)
    steps = TensorDict({"next": {**state, "reward": torch.tensor([[0.0], [reward]])}}, [2])
    failed = FailurePictures()
    for number in range(8):
        failed.add(Episode(steps, "mug", 3, number, "slipped out of the fingers"))
    assert len(failed.pictures) == pictures
    if pictures:
        assert failed.pictures[1].caption == "mug, world 3, episode 1: slipped out of the fingers"


def test_the_middle_step_of_the_first_trajectories_is_drawn():
    T = 5
    poses = torch.eye(4).expand(T, 4, 4)
    steps = TensorDict(
        {"points": torch.rand(T, 8, 4), "T_base_ee": poses, "goal": torch.eye(7)[6].expand(T, 7)}, [T]
    )
    grasps = GraspPictures()
    for _ in range(8):
        grasps.add("mug", steps, poses, poses.unsqueeze(1))
    assert len(grasps.pictures) == 6 and grasps.pictures[0].caption == "mug, step 2 of 5"
    assert grasps.pictures[0].png[:4] == b"\x89PNG"
