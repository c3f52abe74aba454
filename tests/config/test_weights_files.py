"""Weights by name, and what they may bring along."""

from pathlib import Path

import pytest
import torch

from torchgrasp.config.weights_files import brought_along, check_weights, weights_file
from torchgrasp.errors import ConfigError
from torchgrasp.runs import PRETRAINED, save_weights


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


@pytest.mark.parametrize("place", ["model", "transforms"])
def test_classes_of_strangers_are_refused_until_somebody_vouches_for_them(tmp_path, place):
    config = {"model": {}, "transforms": {}, place: {"each": [{"_target_": "os.system"}]}}
    save_weights(tmp_path / "w.safetensors", {"actor": {"w": torch.zeros(1)}}, config)
    with pytest.raises(ConfigError, match=r"the class os\.system, which could run anything: .*trust=\[os\]"):
        brought_along(tmp_path / "w.safetensors", [])
    assert brought_along(tmp_path / "w.safetensors", ["os"]) == config
    assert brought_along(Path("pretrained"), [])["recipe"] in ("bc", "td3_bc", "hindsight")
