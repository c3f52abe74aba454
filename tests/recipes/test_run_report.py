"""report.html of the recipes that write a summary."""

import pytest
import td3_bc
import torch
from albums import FailureAlbum
from evaluate import evaluate
from tensordict import TensorDict

from torchgrasp.rollouts.episode_pool import Episode


def read_report(root, recipe: str) -> str:
    (report,) = root.glob(f"{recipe}/*/report.html")
    return report.read_text()


def test_a_training_run_has_curves_baselines_and_failures(composed, tmp_path):
    td3_bc.train(composed("experiment=smoke", "evaluation.baselines=[random]"))
    text = read_report(tmp_path, "td3_bc")
    assert "<th>policy after imitation alone</th>" in text and "<th>random</th>" in text
    assert 'alt="critic/td_error"' in text and "<td>replay.online_fraction</td>" in text
    # Six steps are too few to grasp: the four episodes failed.
    assert text.count("data:image/png") == 4


def test_an_evaluation_shows_its_failures_and_the_options_that_matter(composed, tmp_path):
    options = ["episodes=4", "evaluation.num_objects=3", "evaluation.num_envs=2", "env.horizon=3"]
    options += ["objects.num_grasps=100", "collector.num_workers=0"]
    evaluate(composed("policy=random", *options, recipe="evaluate"))
    text = read_report(tmp_path, "evaluate")
    assert "<td>evaluation.num_objects</td><td>3</td>" in text
    assert "<td>camera</td><td>RaycastCamera</td>" in text
    assert text.count("data:image/png") == 4


@pytest.mark.parametrize(
    ("reward", "sees_points", "pictures"), [(0.0, True, 6), (1.0, True, 0), (0.0, False, 0)]
)
def test_the_first_failures_that_points_show_are_drawn(reward, sees_points, pictures):
    state = {"T_base_ee": torch.eye(4).expand(2, 4, 4)}
    if sees_points:
        state["points"] = torch.rand(2, 8, 4).round(decimals=1)
    steps = TensorDict({"next": {**state, "reward": torch.tensor([[0.0], [reward]])}}, [2])
    album = FailureAlbum()
    for number in range(8):
        album.add(Episode(steps, "mug", 3, number, "slipped out of the fingers"))
    assert len(album.pictures) == pictures
    if pictures:
        assert album.pictures[1].caption == "mug, world 3, episode 1: slipped out of the fingers"
