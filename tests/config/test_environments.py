"""Every choice that conf/ offers composes, builds, and keeps TorchRL's contract."""

from itertools import product
from pathlib import Path

import pytest
import trimesh
from omegaconf import open_dict
from torchrl.envs import check_env_specs

from tests.configurations import ROOT
from tests.objects.acronym_files import write_acronym
from torchgrasp.config import make_expert, make_pool, make_split_env, observed_shapes, prepare_objects
from torchgrasp.config.environments import make_objects
from torchgrasp.config.schema import Training
from torchgrasp.config.value_checks import check_values
from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.rollouts import ProcessPool, RayPool, SerialPool
from torchgrasp.sim import MujocoEngine, SapienEngine

IMAGES = ("rgb", "rgbd", "rgbdm")
POOLS = {"serial": SerialPool, "pool": ProcessPool, "async": ProcessPool, "ray": RayPool}


def choices(group: str) -> list[str]:
    return sorted(path.stem for path in (ROOT / "conf" / group).glob("*.yaml"))


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


SMALL = ["env.num_envs=2", "env.horizon=3", "objects.num_objects=1", "num_points=32"]
SMALL += ["camera.intrinsics.width=32", "camera.intrinsics.height=32"]


@pytest.mark.parametrize("camera", cameras())
@pytest.mark.parametrize(("env", "transforms"), [*product(choices("env"), choices("transforms"))])
def test_every_environment_passes_check_env_specs(composed, env, camera, transforms):
    cfg = composed(f"env={env}", f"camera={camera}", f"transforms={transforms}", *SMALL)
    if transforms in IMAGES and not camera.startswith("render"):
        with pytest.raises(ConfigError, match="give the env a RenderCamera"):
            check_env_specs(make_split_env(cfg, "train"))
        return
    check_env_specs(make_split_env(cfg, "train"), break_when_any_done="both")


MARKS = dict.fromkeys(("mixture", "random_urdfs", "varied"), (pytest.mark.pybullet,))


@pytest.mark.parametrize("objects", [pytest.param(o, marks=MARKS.get(o, ())) for o in choices("objects")])
def test_the_objects_of_every_kind_are_met(composed, meshes, objects):
    path = [f"objects.path={meshes}"] if objects in ("folder", "acronym") else []
    cfg = composed(f"objects={objects}", "camera=raycast", *SMALL, *path)
    check_env_specs(make_split_env(cfg, "train"), break_when_any_done="both")


def test_transforms_are_tuned_dropped_and_replaced_by_name(composed):
    cfg = composed("transforms.aggregate.alpha=0.9", "~transforms.gripper")
    env = make_split_env(cfg, "train")
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
    td = make_split_env(swapped, "train").reset()
    assert td["flat"].shape[-1] == td["points"][0].numel()


def test_the_evaluation_has_objects_seed_worlds_and_motion_of_its_own(composed):
    given = ["evaluation.num_objects=3", "evaluation.seed=9", "evaluation.num_envs=5"]
    cfg = composed("experiment=smoke", *given, "evaluation.target_motion=jitter")
    train, test = (make_split_env(cfg, split) for split in ("train", "test"))
    assert (train.batch_size[0], test.batch_size[0]) == (2, 5)
    assert (len(train.base_env.objects), len(test.base_env.objects)) == (4, 3)
    assert not set(train.base_env.objects.names) & set(test.base_env.objects.names)
    assert make_expert(cfg, "test").horizon == make_expert(cfg, "train").horizon == 6


@pytest.mark.pybullet
def test_a_mixture_trains_on_no_test_object(composed):
    extra = ["+objects@objects.sets.ycb=ycb", "+objects.weights.ycb=1"]
    cfg = composed("experiment=smoke", "objects=mixture", *extra, "objects.num_objects=100")
    names = {split: set(make_objects(cfg, split).names) for split in ("train", "test")}
    assert not names["train"] & names["test"]
    assert not any("003_cracker_box" in name for name in names["train"])


def test_observed_shapes_are_those_of_one_world(composed):
    shapes = observed_shapes(composed("experiment=smoke"))
    assert shapes["points"] == (38, 4) and shapes["time_left"] == (1,) and shapes["T_base_ee"] == (4, 4)


@pytest.mark.parametrize("name", choices("collector"))
def test_every_collector_makes_its_pool_in_every_recipe(composed, name):
    chosen = [f"collector={name}", f"collector.num_workers={0 if name == 'serial' else 2}"]
    cfg = composed("experiment=smoke", *chosen)
    evaluation = composed("policy=random", *chosen, recipe="evaluate")
    assert evaluation.collector.pool == cfg.collector.pool
    assert cfg.collector.overlap == (name == "async")
    with make_pool(cfg) as pool:
        assert type(pool) is POOLS[name]


def test_no_workers_is_this_process(composed):
    cfg = composed("experiment=smoke", "collector=async", "collector.num_workers=0")
    assert isinstance(make_pool(cfg), SerialPool)


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["env.action_space=joint_delta"], r"^env\.action_space=joint_delta"),
        (["transforms.aggregate.alpha=2"], r"^transforms\.aggregate\.alpha=2 is out of range"),
        (["env.target_motion=jumping"], r"^env\.target_motion=.jumping."),
        (["env.start.table_x=[0.9,0.1]"], r"^env\.start\.table_x"),
    ],
)
def test_what_cannot_be_built_is_refused_by_its_place(composed, overrides, told):
    with pytest.raises(ConfigError, match=told):
        observed_shapes(composed("experiment=smoke", *overrides))


def test_objects_that_cannot_be_had_are_named(composed, tmp_path):
    folder = ["experiment=smoke", "objects=folder"]
    with pytest.raises(ObjectError, match=r"^objects: no/such/folder is not a directory"):
        prepare_objects(composed(*folder, "objects.path=no/such/folder"))
    (tmp_path / "broken.obj").write_bytes(b"\x00\x01 this is no mesh")
    with pytest.raises(ObjectError, match=r"broken\.obj"):
        prepare_objects(composed(*folder, f"objects.path={tmp_path}"))


def test_a_folder_takes_names_and_may_leave_out_what_cannot_be_used(composed, tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHGRASP_CACHE", str(tmp_path / "cache"))
    trimesh.creation.box((0.04, 0.05, 0.12)).export(tmp_path / "box.obj")
    for name in ("bad", "other"):
        (tmp_path / f"{name}.obj").write_text("")
    given = ["objects=folder", f"objects.path={tmp_path}", "objects.num_grasps=100", "objects.min_grasps=90"]
    cfg = composed("policy=random", *given, "objects.include=[bad,box]", recipe="evaluate")
    objects = make_objects(cfg, "test")
    assert objects.names == ("bad", "box") and objects.min_grasps == 90  # pyright: ignore
    cfg = composed("policy=random", *given, "objects.on_error=skip", recipe="evaluate")
    with pytest.warns(UserWarning, match=r"Skipped: .*bad\.obj"):
        assert make_objects(cfg, "test").names == ("box",)


def test_the_engine_is_chosen_by_name_and_its_numbers_reach_it(composed):
    def engine(*given):
        return make_split_env(composed(*given, *SMALL), "train").base_env.worlds.engine

    assert engine() == SapienEngine()
    # conf/ and the class say the same.
    assert engine("engine=mujoco") == MujocoEngine()
    assert engine("engine=mujoco", "engine.substeps=3").substeps == 3
    with pytest.raises(ConfigError, match=r"^engine\.condim=5 is unknown"):
        engine("engine=mujoco", "engine.condim=5")


def test_a_configuration_of_before_there_were_engines_means_the_first(composed):
    cfg = composed(*SMALL)
    with open_dict(cfg):
        del cfg["engine"]
    check_values(cfg, Training)
    assert make_split_env(cfg, "test").base_env.worlds.engine == SapienEngine()


def test_what_is_no_engine_is_refused_before_a_run_begins(composed):
    for wrong in ("mujoco", {"_target_": "torchgrasp.sim.RaycastCamera"}):
        cfg = composed(*SMALL)
        cfg.engine = wrong
        with pytest.raises(ConfigError, match="engine"):
            check_values(cfg, Training)
