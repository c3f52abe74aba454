"""The policy that comes with the library grasps objects that it has never seen."""

import json
from pathlib import Path

from torchgrasp.objects import ProceduralObjects
from torchgrasp.runs.weights import PRETRAINED, load_weights

OPTIONS = ["episodes=21", "evaluation.num_envs=7", "evaluation.num_objects=8", "collector.num_workers=1"]


def read_summary(tmp_path: Path) -> dict:
    (path,) = tmp_path.glob("evaluate/*/summary.json")
    return json.loads(path.read_text())


def test_it_lifts_most_objects_of_the_test_split(run_recipe, tmp_path):
    """Its measured rate is above 90 %; chance that such a policy lifts fewer than 14 of 21 is below 1e-3."""
    code, _, err = run_recipe("evaluate", "policy=pretrained", *OPTIONS)
    assert code == 0, err
    summary = read_summary(tmp_path)
    assert summary["episodes"] == 21
    assert summary["success_rate"] > 0.66


def test_it_can_be_trained_on(run_recipe):
    chosen = [
        "experiment=smoke",
        "model=pointnet",
        "model.width=1",
        "model.table_input=true",
        "model.state_inputs={wrist_angle: 1}",
        "pretrain.steps=0",
    ]
    code, _, err = run_recipe("td3_bc", *chosen, "init=pretrained", "evaluation.baselines=[]")
    assert code == 0, err


def test_its_file_is_small_and_tells_how_it_came_about():
    assert PRETRAINED.stat().st_size < 8e6
    told = json.loads(PRETRAINED.with_suffix(".json").read_text())
    assert told["command"].startswith("python recipes/")
    assert 0.9 < told["results"]["procedural, test"]["success_rate"] <= 1.0


def test_it_names_no_folder_of_the_machine_that_trained_it():
    _, config = load_weights(PRETRAINED)
    assert not any(text.startswith("/") for text in _texts(config))


def test_objects_that_it_is_scored_on_are_none_that_it_learned_from():
    _, config = load_weights(PRETRAINED)
    learned = {name for each in config["objects"]["sets"].values() for name in [each["_target_"]]}
    assert config["objects"]["split"] == "train"
    assert all("Ycb" not in name for name in learned)
    train, test = (set(ProceduralObjects(split, num_grasps=100).names) for split in ("train", "test"))
    assert not train & test


def _texts(value) -> list[str]:
    if isinstance(value, str):
        return [value]
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [text for part in parts for text in _texts(part)]
