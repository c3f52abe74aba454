"""What may stand where a part is expected: in one's own configuration, and in a file from somebody else."""

import copy
import sys

import pytest
from omegaconf import OmegaConf

from tests.configurations import ROOT, compose_config
from torchgrasp.config.part_kinds import check_parts, check_strangers_parts
from torchgrasp.errors import ConfigError
from torchgrasp.runs import PRETRAINED, load_weights

PATH = "torchgrasp.runs.weights.Path"  # pathlib, reached through one of our modules
TRANSFORM = {"_target_": "torchgrasp.transforms.SamplePoints", "num_points": 8}


@pytest.fixture(scope="module")
def config():
    return OmegaConf.to_container(compose_config("overhead=raycast", "replay=prioritised"), resolve=True)


def changed(config, place: str, value) -> dict:
    result = copy.deepcopy(config)
    *outer, last = place.split(".")
    node = result
    for key in outer:
        node = node[key]
    node[last] = value
    return result


def resolved(*overrides: str, recipe: str = "td3_bc") -> dict:
    return OmegaConf.to_container(compose_config(*overrides, recipe=recipe), resolve=True)


@pytest.mark.parametrize("experiment", ["laptop", "demo", "paper", "smoke", "minutes"])
@pytest.mark.parametrize("recipe", ["td3_bc", "bc", "hindsight"])
def test_our_own_configurations_pass_both(recipe, experiment):
    plain = resolved(f"experiment={experiment}", recipe=recipe)
    check_parts(plain)
    check_strangers_parts(plain, "a run")


def list_choices() -> list[str]:
    """Every choice of every group of conf/ that holds parts."""
    groups = ("camera", "overhead", "collector", "expert", "loss", "model", "objects", "planning", "start")
    files = [file for group in (*groups, "transforms") for file in (ROOT / "conf" / group).glob("*.yaml")]
    return sorted(f"{file.parent.name}={file.stem}" for file in files)


@pytest.mark.parametrize("choice", list_choices())
def test_every_part_of_conf_stands_at_a_known_place(choice):
    recipe = "td3_bc" if choice.startswith(("model", "loss")) else "evaluate"
    further = ["policy=planning"] if recipe == "evaluate" else []
    further += ["objects.path=meshes"] if choice in ("objects=folder", "objects=acronym") else []
    plain = resolved(choice, *further, recipe=recipe)
    check_parts(plain)
    check_strangers_parts(plain, "a run")


def write(text: str) -> dict:
    return {
        "_target_": f"{PATH}.write_text",
        "_args_": [{"_target_": PATH, "_args_": ["touched"]}, text],
    }


@pytest.mark.parametrize(
    ("place", "node", "told"),
    [
        ("camera", write("x"), "camera has _args_, _target_"),
        ("transforms.points", write("x"), r"transforms\.points has _args_"),
        ("camera.intrinsics", write("x"), r"camera\.intrinsics has _args_"),
        ("camera.extra", [{"deep": write("x")}], r"camera\.extra\.0\.deep has _args_"),
        ("camera", {"_target_": f"{PATH}.touch"}, "camera names .*no class of torchgrasp"),
        ("camera", {"_target_": PATH}, "camera names .*no class of torchgrasp"),
        (
            "camera",
            {"_target_": "hydra.utils.get_method", "path": "os.system"},
            r"names hydra.*trust=\[hydra\]",
        ),
        ("camera", {"_target_": "torchrl.record.CSVLogger", "exp_name": "x"}, r"names torchrl\.record"),
        (
            "transforms.points",
            {"_target_": "torchrl.envs.transforms.VC1Transform"},
            "no class of torchgrasp or",
        ),
        (
            "transforms.points",
            {"_target_": "torchrl.envs.llm.transforms.MCPToolTransform"},
            "transforms.points",
        ),
        ("camera", TRANSFORM, r"camera\._target_=.*SamplePoints is no Camera"),
        ("transforms.points", {"_target_": "torchgrasp.sim.RaycastCamera"}, "is no Transform"),
        (
            "transforms.points",
            {**TRANSFORM, "_partial_": True},
            "has _partial_, _target_, which",
        ),
        ("transforms.points", {**TRANSFORM, "_recursive_": False}, "_recursive_"),
        ("model.actor.encoder", {"_target_": "torchgrasp.modules.PointNet"}, "which does not belong there"),
        ("model.actor.encoder", {"_target_": "torchgrasp.runs.load_weights", "_partial_": True}, "no class"),
        ("transforms.points", {"_target_": "torchgrasp.__main__.main"}, r"names torchgrasp\.__main__"),
        ("transforms.points", {"_target_": "torchgrasp.errors.Integral.__class__"}, "names"),
        ("transforms.points", {"_target_": 5}, "names 5"),
        ("transforms.points", {"_target_": "torchgrasp.no.such.Class"}, "cannot be imported"),
        ("num_points", TRANSFORM, "num_points names"),
        ("camera", "${oc.decode:'{_target_: numpy.zeros, shape: 3}'}", "a reference, camera="),
        ("env.horizon", "${oc.env:HOME}", r"a reference, env\.horizon="),
    ],
)
def test_a_strangers_file_names_no_code(config, place, node, told):
    with pytest.raises(ConfigError, match=rf"^w\.safetensors (could run anything|holds).*{told}"):
        check_strangers_parts(changed(config, place, node), "w.safetensors")


def test_depth_is_bounded(config):
    node = 1
    for _ in range(50):
        node = {"more": node}
    with pytest.raises(ConfigError, match="more than 20 levels deep"):
        check_strangers_parts({"camera": node}, "w.safetensors")


def test_torchrls_plain_transforms_may_stand_there(config):
    node = {"_target_": "torchrl.envs.StepCounter", "max_steps": 9}
    check_strangers_parts(changed(config, "transforms.counter", node), "w.safetensors")


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of somebody's own: a transform with a part of its own, a function, an alias of os."""
    (tmp_path / "grasp_extras.py").write_text(
        "import os\n"
        "from torchgrasp.transforms import SamplePoints\n"
        "class Noise: pass\n"
        "class Mine(SamplePoints): pass\n"
        "def make(**options): return Mine(**options)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "grasp_extras"
    sys.modules.pop("grasp_extras", None)


def test_packages_that_are_trusted_lend_their_classes_and_no_more(config, package):
    mine = changed(config, "transforms.sample", {**TRANSFORM, "_target_": f"{package}.Mine"})
    with pytest.raises(ConfigError, match=r"trust=\[grasp_extras\]"):
        check_strangers_parts(mine, "w.safetensors")
    assert package not in sys.modules
    check_strangers_parts(mine, "w.safetensors", [package])
    mine["transforms"]["sample"]["noise"] = {"_target_": f"{package}.Noise"}
    check_strangers_parts(mine, "w.safetensors", [package])
    for name in ("make", "os.system", "os"):
        with pytest.raises(ConfigError, match="no class of torchgrasp"):
            node = {**TRANSFORM, "_target_": f"{package}.{name}"}
            check_strangers_parts(changed(config, "transforms.sample", node), "w.safetensors", [package])
    with pytest.raises(ConfigError, match="Noise is no Transform"):
        node = {"_target_": f"{package}.Noise"}
        check_strangers_parts(changed(config, "transforms.sample", node), "w.safetensors", [package])


@pytest.mark.parametrize(
    ("place", "node", "told"),
    [
        ("model.actor", None, r"^model\.actor=None: give a TensorDictModuleBase"),
        ("transforms.sample", 5, r"^transforms\.sample=5: give a Transform"),
        (
            "transforms.sample",
            {"_target_": "no.such.Class"},
            r"^transforms\.sample\._target_=no\.such",
        ),
        ("replay.codec", None, r"^replay\.codec=None: give a CompactTransitions"),
        ("camera", {"_target_": "os.getcwd"}, r"^camera\._target_=.*getcwd is no Camera"),
        ("overhead", [1], r"^overhead=\[1\]: give a Camera, .* or null"),
        ("expert.planner", {"_target_": "torchgrasp.sim.Physics"}, "is no Planner"),
    ],
)
def test_ones_own_configuration_needs_parts_of_the_right_kind(config, place, node, told):
    with pytest.raises(ConfigError, match=told):
        check_parts(changed(config, place, node))


def test_classes_of_any_package_do_in_ones_own_configuration(config, package):
    check_parts(changed(config, "transforms.sample", {**TRANSFORM, "_target_": f"{package}.Mine"}))


def test_the_pretrained_policy_is_read_as_a_strangers():
    _, brought = load_weights(PRETRAINED)
    taken = {name: brought[name] for name in ("env", "camera", "overhead", "transforms", "model", "replay")}
    check_strangers_parts(taken, str(PRETRAINED))
