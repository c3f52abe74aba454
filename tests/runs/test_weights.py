import json

import pytest
import torch
from torch import nn

from tests.hostile_values import TEXTS, check_each
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs.weights import PRETRAINED, load_weights, save_weights

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


def save(file):
    save_weights(file, {"net": nn.Linear(3, 2), "other": nn.Linear(1, 1)}, CONFIG)
    return file


def read_parts(file):
    """The header of a safetensors file, and the bytes of its tensors."""
    content = file.read_bytes()
    size = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + size]), content[8 + size :]


def write_parts(file, header, tensors):
    text = json.dumps(header).encode()
    file.write_bytes(len(text).to_bytes(8, "little") + text + tensors)


def test_one_flipped_bit_is_found_in_every_tensor_and_in_the_config(tmp_path):
    file = save(tmp_path / "w.safetensors")
    whole = file.read_bytes()
    start = len(whole) - len(read_parts(file)[1])
    for place in (*range(start, len(whole)), whole.index(b"0.5"), whole.index(b"net")):
        changed = bytearray(whole)
        changed[place] ^= 1
        file.write_bytes(changed)
        with pytest.raises(CheckpointError, match=r"w\.safetensors"):
            load_weights(file)


def test_hostile_metadata_is_refused(tmp_path):
    file = save(tmp_path / "w.safetensors")
    header, tensors = read_parts(file)
    told = dict(header["__metadata__"])

    def write(metadata):
        write_parts(file, {**header, "__metadata__": metadata}, tensors)

    assert check_each(told, write, lambda: load_weights(file), free=lambda _: False) > 40
    for name in ("config", "modules"):
        for value in (*TEXTS.values(), b"[1e23]", b'[["net"]]', b'["net"]', b'{"a": "\\ud800"}'):
            write({**told, name: value.decode(errors="replace")})
            with pytest.raises(CheckpointError):
                load_weights(file)


def test_a_hostile_header_is_refused(tmp_path):
    file = save(tmp_path / "w.safetensors")
    header, tensors = read_parts(file)

    def free(words):  # of metadata another test tells
        return words.startswith("__metadata__") or words.endswith(": more")

    check_each(header, lambda each: write_parts(file, each, tensors), lambda: load_weights(file), free=free)


def test_files_of_the_version_before_checksums_are_read(tmp_path):
    file = save(tmp_path / "w.safetensors")
    header, tensors = read_parts(file)
    told = header["__metadata__"]
    del told["sha256"]
    write_parts(file, header, tensors)
    with pytest.raises(CheckpointError, match="or is missing"):
        load_weights(file)
    write_parts(file, {**header, "__metadata__": {**told, "torchgrasp": "0.1.0"}}, tensors)
    assert load_weights(file)[1] == CONFIG


def test_the_pretrained_policy_has_a_checksum():
    assert "sha256" in read_parts(PRETRAINED)[0]["__metadata__"]
    assert load_weights(PRETRAINED)[1]["recipe"] == "td3_bc"
