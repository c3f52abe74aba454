"""The ablation "L2 pose loss" by one override."""

import pytest
import torch
from learner import Learner

# 3 and 4 cm, as an action and as a goal.
ACTION = torch.tensor([[0.03, -0.04, 0, 0, 0, 0]])
GOAL = torch.tensor([[0.03, -0.04, 0, 0, 0, 0, 1]])
REST = torch.tensor([[0.0, 0, 0, 0, 0, 0, 1]])


@pytest.mark.parametrize("loss", ["td3_bc", "td3_bc_laptop", "bc"])
@pytest.mark.parametrize(("overrides", "expected"), [([], 0.07), (["loss.distance.norm=l2"], 0.05)])
def test_the_norm_reaches_every_pose_loss(composed, loss, overrides, expected):
    learner = Learner(
        composed("experiment=smoke", f"loss={loss}", *overrides),
        {"points": (38, 4), "time_left": (1,), "table_plane": (4,), "wrist_angle": (1,)},
    )
    for each in (learner.loss, learner.imitation):
        assert each.distance(ACTION, torch.zeros(1, 6)).item() == pytest.approx(expected)
        assert each.goal_distance(GOAL, REST).item() == pytest.approx(expected)
