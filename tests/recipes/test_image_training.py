"""Image policies by configuration: collected, stored, trained, evaluated, read back."""

import pytest
import td3_bc
from evaluate import evaluate

SMALL = [
    "experiment=smoke",
    "model=resnet18",
    "model.width=0.25",
    "replay=images",
    "transforms.image.size=32",
]
SHORT = ["total_env_steps=12", "evaluation.baselines=[]", "evaluation.episodes=2"]
DEPTH = ["transforms.image.channels=dm", "model.channels=2", "model.encoder.rgb=false"]
COLOUR = ["camera=render"]


@pytest.mark.parametrize(
    "chosen", [DEPTH, pytest.param(COLOUR, marks=pytest.mark.vulkan)], ids=["dm", "rgbd"]
)
def test_images_train_and_come_back(composed, tmp_path, chosen):
    summary = td3_bc.train(composed(*SMALL, "transforms=rgbd", "transforms.image.size=32", *SHORT, *chosen))
    assert summary["gradient_steps"] >= 6 and summary["env_steps"] >= 12
    run_dir = next((tmp_path / "td3_bc").iterdir())
    options = [
        "episodes=2",
        "seed=1000",
        "evaluation.num_envs=2",
        "evaluation.num_objects=4",
        "objects.num_grasps=100",
    ]
    again = evaluate(composed(f"policy={run_dir}", *options, "collector.num_workers=0", recipe="evaluate"))
    assert again["objects"] == summary["objects"]
