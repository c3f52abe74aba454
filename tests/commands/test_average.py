"""torchgrasp average: a policy of the mean, faults in one line."""

import pytest
import torch

import torchgrasp
from torchgrasp.commands.command_line import main
from torchgrasp.modules import MirroredPolicy
from torchgrasp.runs.weights import PRETRAINED, load_weights, save_weights


def test_the_mean_of_a_policy_with_itself_is_that_policy(tmp_path, capsys):
    output = tmp_path / "mean.safetensors"
    assert main(["average", "pretrained", str(PRETRAINED), "--output", str(output)]) == 0
    assert capsys.readouterr().out == f"Written to {output}: actor of 2 policies\n"
    mean, itself = (load_weights(path)[0]["actor"] for path in (output, PRETRAINED))
    assert all(torch.equal(mean[key], value) for key, value in itself.items())
    torchgrasp.load_policy(str(output))


def test_one_policy_is_made_to_act_by_its_mean_over_reflections(tmp_path):
    output = tmp_path / "mirrored.safetensors"
    assert main(["average", "pretrained", "--mirrored", "--output", str(output)]) == 0
    policy, itself = torchgrasp.load_policy(str(output)), torchgrasp.load_policy("pretrained")
    assert isinstance(policy[0], MirroredPolicy) and policy.in_keys == itself.in_keys
    mean, single = (load_weights(path)[0]["actor"] for path in (output, PRETRAINED))
    assert all(torch.equal(mean[key], value) for key, value in single.items())


def test_policies_that_see_otherwise_are_refused(tmp_path, capsys):
    states, config = load_weights(PRETRAINED)
    config["transforms"]["sample"]["num_points"] = 512
    other, output = tmp_path / "other.safetensors", tmp_path / "mean.safetensors"
    save_weights(other, states, config)
    assert main(["average", "pretrained", str(other), "--output", str(output)]) == 1
    assert f"{other} learned with another transforms than {PRETRAINED}" in capsys.readouterr().err
    assert not output.exists()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["pretrained"], "two or more"),
        (["pretrained", "nobody"], "policy='nobody' is not there"),
        (["pretrained", "pretrained", "--output", "/proc/mean.safetensors"], "cannot be written"),
    ],
)
def test_faults_are_told_in_one_line(options, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["average", *options]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and told in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())
