"""Weights by name, and what they may bring along."""

from pathlib import Path

import pytest

from torchgrasp.config.weights_files import check_weights, read_trained, weights_file
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import PRETRAINED, load_weights, save_weights


def test_a_run_directory_a_file_or_the_policy_that_comes_along(tmp_path):
    assert weights_file(Path("pretrained")) == PRETRAINED
    assert weights_file(tmp_path) == tmp_path / "weights.safetensors"
    assert weights_file(tmp_path / "w.safetensors") == tmp_path / "w.safetensors"


def test_a_directory_without_weights_is_told_from_none(tmp_path):
    check_weights("init", "pretrained")
    with pytest.raises(
        ConfigError, match=r"^init='.*' holds no weights\.safetensors: give the run directory"
    ):
        check_weights("init", str(tmp_path))
    told = (
        r"^policy='nobody' is not there: give expert, random, pretrained, a run directory or a weights file"
    )
    with pytest.raises(ConfigError, match=told):
        check_weights("policy", "nobody", "expert", "random")


def saved(path, change=lambda config: None):
    """A weights file with the pretrained policy's configuration, changed."""
    states, config = load_weights(PRETRAINED)
    change(config)
    save_weights(path, states, config)
    return path


def test_what_is_taken_over_rebuilds_the_networks_and_nothing_else():
    trained = read_trained(Path("pretrained"))
    assert trained.config["recipe"] in ("bc", "td3_bc", "hindsight")
    assert set(trained.states) == {"actor", "critic"}
    assert not {"objects", "expert", "loss", "collector", "output_dir"} & set(trained.config)


def test_what_is_not_taken_over_may_be_anything(tmp_path):
    path = saved(tmp_path / "w.safetensors", lambda config: config.update(expert={"_target_": "os.system"}))
    assert "expert" not in read_trained(path).config


def test_code_is_refused_by_its_place_before_anything_is_called(tmp_path):
    touched = tmp_path / "touched"
    for place in ("camera", "overhead"):
        node = {"_target_": "torchgrasp.runs.weights.Path.touch", "self": str(touched)}
        path = saved(
            tmp_path / "w.safetensors", lambda config, place=place, node=node: config.update({place: node})
        )
        with pytest.raises(ConfigError, match=rf"could run anything: {place} names torchgrasp\.runs"):
            read_trained(path)
    assert not touched.exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda config: config.pop("model"), "model is missing"),
        (lambda config: config.update(model=5), "model=5 is no section"),
        (lambda config: config.update(env={"horizon": 10**9}), r"env\.horizon=1000000000 is out of range"),
        (lambda config: config.update(num_points=-1), "num_points=-1 is out of range"),
        (lambda config: config.update(transforms=[1]), "transforms="),
        (lambda config: config["model"].pop("actor"), "model.actor is missing"),
        (lambda config: config["model"].update(actor=[1]), "model.actor="),
        (lambda config: config["model"]["actor"].pop("_target_"), "model.actor="),
        (lambda config: config["model"]["critic"].update(encoder=[1]), r"model\.critic\.encoder="),
        (lambda config: config["model"].update(goal_network=[1]), "model.goal_network="),
    ],
)
def test_a_file_that_tells_too_little_or_nonsense_is_refused(tmp_path, change, told):
    with pytest.raises(CheckpointError, match=rf"w\.safetensors has a configuration of no recipe: {told}"):
        read_trained(saved(tmp_path / "w.safetensors", change))
