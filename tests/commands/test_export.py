"""torchgrasp export: options as recipes take them, files named, faults in one line."""

import pytest

from torchgrasp.commands.command_line import main


def test_files_are_written_and_named(tmp_path, capsys):
    assert main(["export", "policy=pretrained", "format=onnx", f"output={tmp_path}/grasp.onnx"]) == 0
    names = ["grasp.onnx", "grasp.json", "grasp_policy.py"]
    assert capsys.readouterr().out.splitlines() == [f"Written to {tmp_path / name}" for name in names]
    assert sorted(names) == sorted(file.name for file in tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["policy=nobody"], "policy='nobody' is not there: give pretrained, a run directory or"),
        (["policy=."], "policy='.' holds no weights.safetensors"),
        ([f"policy={'x' * 300}"], "cannot be a path"),
        (["output=/proc/policy.onnx"], "/proc/policy.onnx cannot be written"),
        (["format=tflite"], "format='tflite' is unknown"),
        (["pretrained"], "'pretrained' is no option: give policy=..., format=..., output=..."),
        (["device=cuda"], "'device=cuda' is no option"),
        (["policy="], "'policy=' is no option"),
        (["format=onnx", "format=onnx"], "format is given twice"),
        (["format=torch_export", "output=a.onnx"], "does not end with .pt2"),
    ],
)
def test_faults_are_told_in_one_line(options, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export", *options]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and told in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())
