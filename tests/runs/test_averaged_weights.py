import pytest
import torch
from torch import nn

from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs.averaged_weights import average_weights
from torchgrasp.runs.weights import load_weights, save_weights

CONFIG = {"num_points": 256, "resume": "there/run", "init": "there", "output_dir": "here", "seed": 3}


def save(path, value: float, **others: nn.Module):
    """A file of a network whose weights all are `value`, and whose batches it has counted."""
    net = nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3))
    for parameter in net.parameters():
        nn.init.constant_(parameter, value)
    net[1].num_batches_tracked.fill_(int(value))
    save_weights(path, {"actor": net, **others}, CONFIG)
    return path


def test_the_mean_of_floats_and_the_first_of_counters(tmp_path):
    files = [save(tmp_path / f"{value}.safetensors", value) for value in (1.0, 2.0, 6.0)]
    output = tmp_path / "new" / "mean.safetensors"
    assert average_weights(files, output) == ["actor"]
    states, config = load_weights(output)
    assert torch.equal(states["actor"]["0.weight"], torch.full((3, 2), 3.0))
    assert int(states["actor"]["1.num_batches_tracked"]) == 1
    assert config == {"num_points": 256, "resume": None, "init": None, "output_dir": "outputs", "seed": 3}


def test_networks_that_not_all_hold_are_left_out(tmp_path):
    one = save(tmp_path / "one.safetensors", 1.0, critic=nn.Linear(2, 2))
    other = save(tmp_path / "other.safetensors", 3.0)
    assert average_weights([one, other], tmp_path / "mean.safetensors") == ["actor"]
    assert list(load_weights(tmp_path / "mean.safetensors")[0]) == ["actor"]


def test_what_has_no_mean_is_told_and_nothing_is_written(tmp_path):
    one = save(tmp_path / "one.safetensors", 1.0)
    save_weights(tmp_path / "wide.safetensors", {"actor": nn.Sequential(nn.Linear(2, 4))}, CONFIG)
    save_weights(tmp_path / "critic.safetensors", {"critic": nn.Linear(2, 2)}, CONFIG)
    output = tmp_path / "mean.safetensors"
    with pytest.raises(ConfigError, match="one or more"):
        average_weights([], output)
    with pytest.raises(ConfigError, match=r"actor of .*wide.safetensors is built otherwise .*0.bias"):
        average_weights([one, tmp_path / "wide.safetensors"], output)
    with pytest.raises(ConfigError, match="no network in common"):
        average_weights([one, tmp_path / "critic.safetensors"], output)
    with pytest.raises(CheckpointError, match="no weights file"):
        average_weights([one, tmp_path / "gone.safetensors"], output)
    assert not output.exists()
