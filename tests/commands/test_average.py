"""torchgrasp average: a policy of the mean, faults in one line."""

import pytest
import torch

import torchgrasp
from torchgrasp.commands.command_line import main
from torchgrasp.modules import MirroredPolicy, ResidualPolicy
from torchgrasp.runs.weights import PRETRAINED, load_weights, save_weights


def test_the_mean_of_a_policy_with_itself_is_that_policy(tmp_path, capsys):
    output = tmp_path / "mean.safetensors"
    assert main(["average", "pretrained", str(PRETRAINED), "--output", str(output)]) == 0
    assert capsys.readouterr().out == f"Written to {output}: actor, critic of 2 policies\n"
    mean, itself = (load_weights(path)[0]["actor"] for path in (output, PRETRAINED))
    assert all(torch.equal(mean[key], value) for key, value in itself.items())
    torchgrasp.load_policy(str(output))


def test_one_policy_is_made_to_act_by_its_mean_over_reflections(tmp_path):
    output, single = tmp_path / "mirrored.safetensors", tmp_path / "single.safetensors"
    change(single, model__mirrored=False)
    assert main(["average", str(single), "--mirrored", "--output", str(output)]) == 0
    policy, itself = torchgrasp.load_policy(str(output)), torchgrasp.load_policy(str(single))
    assert isinstance(policy[0], MirroredPolicy) and not isinstance(itself[0], MirroredPolicy)
    assert policy.in_keys == itself.in_keys
    ours, theirs = (load_weights(path)[0]["actor"] for path in (output, PRETRAINED))
    assert all(torch.equal(ours[key], value) for key, value in theirs.items())


def test_a_correction_is_left_out_on_demand(tmp_path, capsys):
    plain, mean = tmp_path / "plain.safetensors", tmp_path / "mean.safetensors"
    assert main(["average", "pretrained", "--uncorrected", "--output", str(plain)]) == 0
    assert capsys.readouterr().out == f"Written to {plain}: actor of one policy\n"
    states, config = load_weights(plain)
    assert config["model"]["residual"] is None and config["model"]["mirrored"]
    before = ResidualPolicy.find_corrected(load_weights(PRETRAINED)[0]["actor"])
    assert all(torch.equal(states["actor"][key], value) for key, value in before.items())
    torchgrasp.load_policy(str(plain))
    moved = {"actor": {key: value + 1 for key, value in before.items()}}
    save_weights(plain, moved, {**config, "model": {**config["model"], "mirrored": False}})
    for order in ([str(plain), "pretrained"], ["pretrained", str(plain)]):
        assert main(["average", *order, "--output", str(mean)]) == 1
        error = capsys.readouterr().err
        assert "by --uncorrected, or have the mean act over reflections by --mirrored" in error
        assert main(["average", *order, "--uncorrected", "--mirrored", "--output", str(mean)]) == 0
        averaged, told = load_weights(mean)
        assert told["model"]["residual"] is None and told["model"]["mirrored"]
        for key, value in before.items():
            torch.testing.assert_close(averaged["actor"][key], value + 0.5)
        mean.unlink()
    assert main(["average", str(plain), "--uncorrected", "--output", str(mean)]) == 1
    assert "no correction to leave out" in capsys.readouterr().err and not mean.exists()


def change(path, *, drop=(), **sections):
    """A file of the pretrained policy whose configuration differs: option -> value, sections by __."""
    states, config = load_weights(PRETRAINED)
    for name, value in sections.items():
        *places, last = name.split("__")
        section = config
        for place in places:
            section = section[place]
        section[last] = value
    for name in drop:
        del config["env"][name]
    save_weights(path, states, config)
    return path


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"transforms__sample__num_points": 512}, "other transforms"),
        ({"env__action_space": "joint_delta"}, "other action_space"),
        ({"model__mirrored": False}, "its model.mirrored"),
        ({"model__actor__table_input": False}, "its model.actor.table_input"),
        ({"model": None}, "configuration of no recipe"),
        ({"env": 3}, "configuration of no recipe"),
    ],
)
def test_policies_that_do_otherwise_and_damaged_files_are_refused(changed, told, tmp_path, capsys):
    other, output = change(tmp_path / "other.safetensors", **changed), tmp_path / "mean.safetensors"
    assert main(["average", "pretrained", str(other), "--output", str(output)]) == 1
    error = capsys.readouterr().err
    assert str(other) in error and told in error and error.count("\n") == 1
    assert not output.exists()


def test_an_older_file_has_the_defaults_that_it_leaves_out(tmp_path):
    older = change(tmp_path / "older.safetensors", drop=["action_space"])
    assert main(["average", "pretrained", str(older), "--output", str(tmp_path / "mean.safetensors")]) == 0


def test_who_knows_no_reflections_does_not_act_by_their_mean(tmp_path, capsys):
    plain = change(tmp_path / "plain.safetensors", replay__augment=None)
    output = tmp_path / "mean.safetensors"
    assert main(["average", str(plain), "--mirrored", "--output", str(output)]) == 1
    assert "replay.augment=null" in capsys.readouterr().err and not output.exists()


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
