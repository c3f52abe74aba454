"""Every choice that conf/ offers composes, builds, and keeps TorchRL's contract."""

from itertools import product
from pathlib import Path

import common
import pytest
import trimesh
from acronym_files import write_acronym
from hydra.utils import instantiate
from learner import Learner
from torchrl.envs import check_env_specs

from torchgrasp.errors import ConfigError

IMAGES = ("rgb", "rgbd", "rgbdm")
CONF = Path(__file__).parents[2] / "conf"


def choices(group: str) -> list[str]:
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


def cameras() -> list:
    """Choices of a camera; those that render need something to render on."""
    return [
        pytest.param(name, marks=pytest.mark.vulkan) if name.startswith("render") else name
        for name in choices("camera")
    ]


@pytest.fixture(scope="module")
def meshes(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    trimesh.creation.box((0.05, 0.06, 0.10)).export(folder / "box.stl")
    write_acronym(folder)
    return folder


@pytest.mark.parametrize("camera", cameras())
@pytest.mark.parametrize(
    ("env", "objects", "transforms"), [*product(choices("env"), choices("objects"), choices("transforms"))]
)
def test_every_environment_passes_check_env_specs(composed, meshes, env, objects, camera, transforms):
    chosen = [f"env={env}", f"objects={objects}", f"camera={camera}", f"transforms={transforms}"]
    chosen += ["env.num_envs=2", "env.horizon=3", "objects.num_objects=1"]
    chosen += [f"objects.path={meshes}"] if objects in ("folder", "acronym") else []
    if transforms in IMAGES:
        # The experiments tune the points that networks see, which image presets do not have.
        cfg = composed(
            *chosen, "camera.intrinsics.width=32", "camera.intrinsics.height=32", recipe="benchmark"
        )
        if not camera.startswith("render"):
            with pytest.raises(ConfigError, match="choose camera=render"):
                check_env_specs(common.make_env(cfg, "train"))
            return
    else:
        cfg = composed("experiment=smoke", *chosen)
    check_env_specs(common.make_env(cfg, "train"), break_when_any_done="both")


@pytest.mark.parametrize("experiment", choices("experiment"))
@pytest.mark.parametrize("model", choices("model"))
@pytest.mark.parametrize("loss", choices("loss"))
def test_every_learner_builds(composed, experiment, model, loss):
    chosen = ["transforms=rgbd", "replay=images", "replay.augment=null"] if model == "resnet18" else []
    cfg = composed(f"experiment={experiment}", f"model={model}", f"loss={loss}", "model.width=0.25", *chosen)
    shapes = {"points": (262, 4), "image": (4, 112, 112), "time_left": (1,), "table_plane": (4,)}
    shapes |= {"wrist_angle": (1,)}
    learner = Learner(cfg, shapes)
    assert learner.loss.bc_weight == {"bc": 1.0, "td3_bc": 0.2, "td3_bc_laptop": 0.98}[loss]
    assert learner.targets.period == cfg.online.period


@pytest.mark.parametrize("recipe", ["td3_bc", "bc", "hindsight", "evaluate", "benchmark"])
def test_main_configurations_compose(composed, recipe):
    cfg = composed(*(["policy=random"] if recipe == "evaluate" else []), recipe=recipe)
    assert instantiate(cfg.camera).intrinsics.width == 112


def test_transforms_are_tuned_dropped_and_replaced_by_name(composed):
    cfg = composed("transforms.aggregate.alpha=0.9", "~transforms.gripper")
    env = common.make_env(cfg, "train")
    assert [type(each).__name__ for each in env.transform] == [
        "DepthToPoints",
        "AggregatePoints",
        "SamplePoints",
        "TablePlane",
        "WristAngle",
    ]
    assert env.transform[1].alpha == 0.9
    swapped = composed(
        "experiment=smoke",
        "+transforms.flatten={_target_: torchrl.envs.FlattenObservation, first_dim: -2, last_dim: -1,"
        " in_keys: [points], out_keys: [flat]}",
    )
    td = common.make_env(swapped, "train").reset()
    assert td["flat"].shape[-1] == td["points"][0].numel()


def test_a_mixture_trains_on_no_test_object(composed):
    extra = ["+objects@objects.sets.ycb=ycb", "+objects.weights.ycb=1"]
    cfg = composed("experiment=smoke", "objects=mixture", *extra, "objects.num_objects=100")
    names = {split: set(common.make_objects(cfg, split).names) for split in ("train", "test")}
    assert not names["train"] & names["test"]
    assert not any("003_cracker_box" in name for name in names["train"])


def test_joint_actions_are_refused_where_networks_write_poses(composed):
    with pytest.raises(ConfigError, match="action_space=joint_delta"):
        common.observed_shapes(composed("experiment=smoke", "env.action_space=joint_delta"))
