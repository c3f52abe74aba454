"""The weights that come with the library: their size, what they tell, and what they have not seen."""

import json

from torchgrasp.objects import ProceduralObjects
from torchgrasp.runs import PRETRAINED, load_weights


def test_its_file_is_small_and_tells_how_it_came_about():
    assert PRETRAINED.stat().st_size < 8e6
    told = json.loads(PRETRAINED.with_suffix(".json").read_text())
    assert told["command"].startswith("torchgrasp average ")
    # A correction of the mean of a run and the policy before, which was such a mean itself.
    assert told["correction"]["command"].startswith("python recipes/td3_bc.py ")
    runs = [told["run"], told["start"]["run"], told["start"]["start"]]
    assert all(each["command"].startswith("python recipes/bc.py ") for each in runs)
    assert all(each["trained"]["env_steps"] > 0 for each in (told["correction"], *runs))
    (row,) = told["results"]["procedural_test"]["rows"]
    assert 0.9 < row["success_rate"] <= 1.0


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
