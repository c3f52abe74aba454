"""What export writes, and what it refuses by name."""

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from tensordict import TensorDict

from tests.configurations import ROOT
from tests.deploy.pretrained import policy
from tests.deploy.recordings import record
from torchgrasp.config.trained_policy import TrainedPolicy
from torchgrasp.deploy import runner
from torchgrasp.deploy.policy_files import describe_policy, export_policy
from torchgrasp.errors import ConfigError, MissingPackageError, StorageError
from torchgrasp.modules import GraspActor, MirroredPolicy, PointNet, PointNet2, ResidualPolicy
from torchgrasp.transforms import PointTransform, RandomMirror


@pytest.fixture(scope="module")
def states():
    """(120, ...) real states."""
    rows = record(episodes=4).states
    return {name: torch.cat([row[name] for row in rows]) for name in policy().in_keys}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    file = tmp_path_factory.mktemp("exported") / "policy.onnx"
    export_policy(policy(), output=file)
    return file


def compare(file, network, states):
    """Largest differences of action and goal, batch by batch."""
    session = onnxruntime.InferenceSession(str(file))
    said = session.run(None, {each.name: states[each.name].numpy() for each in session.get_inputs()})
    with torch.no_grad():
        expected = network(TensorDict(states, [len(next(iter(states.values())))]))
    names = [each.name for each in session.get_outputs()]
    return {name: np.abs(expected[name].numpy() - each).max() for name, each in zip(names, said, strict=True)}


def test_the_network_is_the_policy_s(exported, states):
    found = compare(exported, policy(), states)
    assert len(states["points"]) >= 100
    assert found["action"] <= 1e-5 and found["goal_prediction"] <= 5e-5


def test_a_policy_of_the_mean_over_reflections_is_exported_whole(states, tmp_path):
    mirrored = TrainedPolicy(MirroredPolicy(policy()[0], RandomMirror()), config=policy().config)
    export_policy(mirrored, output=tmp_path / "policy.onnx")
    found = compare(tmp_path / "policy.onnx", mirrored, states)
    assert found["action"] <= 1e-5 and found["goal_prediction"] <= 5e-5


def test_the_runner_is_the_module_that_is_tested(exported):
    assert exported.with_name("grasp_policy.py").read_text() == Path(runner.__file__).read_text()
    settings = json.loads(exported.with_suffix(".json").read_text())
    assert settings == json.loads(json.dumps(describe_policy(policy(), network="policy.onnx")))
    assert list(runner.TRANSFORMS) == [each["name"] for each in settings["transforms"]]


def test_the_files_tell_nothing_of_the_machine(exported, tmp_path):
    export_policy(policy(), format="torch_export", output=tmp_path / "policy.pt2")
    with zipfile.ZipFile(tmp_path / "policy.pt2") as archive:
        contents = [archive.read(name) for name in archive.namelist()]
    contents += [file.read_bytes() for file in exported.parent.iterdir()]
    for secret in (str(ROOT), "site-packages", sys.prefix, "/tmp"):
        assert not any(secret.encode() in each for each in contents)


def test_an_exported_program_needs_torch_alone(states, tmp_path):
    files = export_policy(policy(), format="torch_export", output=tmp_path / "new" / "policy.pt2")
    assert [file.name for file in files] == ["policy.pt2"]
    torch.save([states[name] for name in policy().in_keys], tmp_path / "states.pt")
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['torchgrasp', 'tensordict', 'torchrl']));"
        "import torch; network = torch.export.load(sys.argv[1]).module();"
        "torch.save(network(*torch.load(sys.argv[2])), sys.argv[3])"
    )
    paths = [str(each) for each in (files[0], tmp_path / "states.pt", tmp_path / "said.pt")]
    subprocess.run([sys.executable, "-I", "-c", code, *paths], check=True, capture_output=True)
    action, goal = torch.load(tmp_path / "said.pt")
    expected = policy()(TensorDict(states, [len(action)]))
    assert (expected["action"] - action).abs().max() <= 1e-5
    assert (expected["goal_prediction"] - goal).abs().max() <= 5e-5


def change(network=None, **config):
    return TrainedPolicy(policy()[0] if network is None else network, config={**policy().config, **config})


def make_actor(encoder=PointNet, **options):
    return GraspActor(encoder, table_input=True, state_inputs={"wrist_angle": 1}, **options)


def test_a_corrected_policy_is_exported(states, tmp_path):
    corrected = ResidualPolicy(make_actor(), last_steps=5, horizon=30)
    torch.nn.init.normal_(corrected.residual.correction.network[-1].weight)
    assert compare(*export(change(corrected), tmp_path), states)["action"] <= 1e-5


def test_a_policy_without_a_goal_is_exported_and_its_goal_is_nan(states, tmp_path):
    file, network = export(change(make_actor(goal_prediction=False)), tmp_path)
    assert set(compare(file, network, states)) == {"action"}
    mask = np.ones((112, 112), dtype=bool)
    hand = np.diag([1.0, -1.0, -1.0, 1.0])
    step = runner.GraspPolicy(file.with_suffix(".json"), T_ee_camera=np.eye(4)).act(
        np.full((112, 112), 0.4), mask, joints=np.array([0, 0, 0, -1.5, 0, 1.5, 0]), T_base_ee=hand
    )
    assert np.isnan(step.goal).all() and step.problem is None


def export(trained, folder):
    return export_policy(trained, output=folder / "policy.onnx")[0], trained


class Strange(PointTransform):
    def __init__(self):
        super().__init__(in_keys=["points"], out_keys=["points"])


def test_a_transform_that_the_runner_cannot_do_is_named(tmp_path):
    transforms = policy().config["transforms"]
    strange = {**transforms, "strange": {"_target_": f"{__name__}.Strange"}}
    with pytest.raises(ConfigError, match="the transform Strange makes"):
        export_policy(change(transforms=strange), output=tmp_path / "policy.onnx")
    overhead = {**transforms, "points": {**transforms["points"], "camera": "overhead"}}
    with pytest.raises(ConfigError, match="DepthToPoints of the overhead camera"):
        export_policy(change(transforms=overhead), output=tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("format", ["onnx", "torch_export"])
def test_operators_of_our_own_are_named(format, tmp_path):
    file = tmp_path / ("policy.onnx" if format == "onnx" else "policy.pt2")
    with pytest.raises(ConfigError, match=r"needs torchgrasp::ball_query.*PointNet"):
        export_policy(change(make_actor(PointNet2)), format=format, output=file)
    assert not file.exists()


def test_another_action_space_is_refused(tmp_path):
    env = {**policy().config["env"], "action_space": "joint_velocity"}
    with pytest.raises(ConfigError, match="action_space=joint_velocity"):
        export_policy(change(env=env), output=tmp_path / "policy.onnx")


def test_what_is_asked_for_wrongly_is_told(tmp_path):
    with pytest.raises(ConfigError, match="format='tflite' is unknown: give onnx or torch_export"):
        export_policy(policy(), format="tflite", output=tmp_path / "policy.onnx")
    with pytest.raises(ConfigError, match=r"does not end with \.pt2"):
        export_policy(policy(), format="torch_export", output=tmp_path / "policy.onnx")
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        export_policy(policy(), output=tmp_path / "file" / "policy.onnx")
    (tmp_path / "policy.onnx").mkdir()
    with pytest.raises(StorageError, match=r"policy\.onnx cannot be written"):
        export_policy(policy(), output=tmp_path / "policy.onnx")


@pytest.mark.parametrize("name", ["policy.onnx", "policy.json", "grasp_policy.py"])
def test_a_file_that_cannot_be_written_leaves_nothing_half_written(name, tmp_path):
    (tmp_path / name).mkdir()
    with pytest.raises(StorageError, match=re.escape(f"{name} cannot be written")) as told:
        export_policy(policy(), output=tmp_path / "policy.onnx")
    assert "\n" not in str(told.value)
    assert not [file.name for file in tmp_path.iterdir() if file.name.startswith(".")]


@pytest.mark.parametrize(("format", "ending"), [("onnx", "onnx"), ("torch_export", "pt2")])
def test_a_folder_that_takes_no_file_is_told(format, ending, tmp_path):
    name = f"{'x' * 250}.{ending}"  # of the longest that a file may have: none fits beside it
    with pytest.raises(StorageError, match="cannot be written") as told:
        export_policy(policy(), format=format, output=tmp_path / name)
    assert "\n" not in str(told.value) and not list(tmp_path.iterdir())
    with pytest.raises(StorageError, match="cannot be written"):
        export_policy(policy(), format=format, output=f"/proc/policy.{ending}")


@pytest.mark.parametrize("package", ["onnx", "onnxruntime", "onnxscript"])
def test_without_the_extra_it_is_named(package, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackageError, match=rf"{package}.*torchgrasp\[export\]"):
        export_policy(policy(), output=tmp_path / "policy.onnx")
