import pytest
import torch
from torch import nn

from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs.weights import load_weights, save_weights

CONFIG = {"model": {"width": 0.5, "layers": [64, 64]}, "seed": 3}


def test_weights_and_config_come_back(tmp_path):
    actor, critic = nn.Linear(3, 4), nn.Sequential(nn.Linear(2, 2), nn.BatchNorm1d(2))
    save_weights(tmp_path / "a" / "w.safetensors", {"actor": actor, "critic": critic}, CONFIG)
    states, config = load_weights(tmp_path / "a" / "w.safetensors")
    assert config == CONFIG
    assert list(states) == ["actor", "critic"]
    for module, state in ((actor, states["actor"]), (critic, states["critic"])):
        assert state.keys() == module.state_dict().keys()
        assert all(torch.equal(state[key], value) for key, value in module.state_dict().items())


def test_tied_parameters_are_written(tmp_path):
    net = nn.ModuleList([nn.Linear(2, 2), nn.Linear(2, 2)])
    net[1].weight = net[0].weight
    save_weights(tmp_path / "w.safetensors", {"net": net}, {})
    states, _ = load_weights(tmp_path / "w.safetensors")
    assert torch.equal(states["net"]["1.weight"], net[0].weight)


def test_wrong_files_are_told(tmp_path):
    file = tmp_path / "w.safetensors"
    with pytest.raises(CheckpointError, match="no weights file"):
        load_weights(file)
    save_weights(file, {"net": nn.Linear(9, 9)}, CONFIG)
    file.write_bytes(file.read_bytes()[:-7])
    with pytest.raises(CheckpointError, match="damaged"):
        load_weights(file)
    torch.save({"net": 1}, file)
    with pytest.raises(CheckpointError, match="no weights file of torchgrasp"):
        load_weights(file)


def test_a_config_that_is_no_json_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="config"):
        save_weights(tmp_path / "w.safetensors", {"net": nn.Linear(1, 1)}, {"x": torch.zeros(1)})
    assert not list(tmp_path.iterdir())
