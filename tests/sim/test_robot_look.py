"""How the robot looks: meshes for people, shapes where there are none, and shapes alone for policies."""

import shutil
import warnings

import numpy as np
import pytest

from tests.sim.states import OVERHEAD, views
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, Randomization, RenderCamera
from torchgrasp.sim.panda_meshes import meshes_folder
from torchgrasp.sim.panda_pose import arm_poses, hand_poses
from torchgrasp.sim.robot_look import mesh_look, robot_look


@pytest.fixture(scope="module")
def target():
    return ProceduralObjects("train", num_objects=1, num_grasps=100)[0]


@pytest.mark.pybullet
def test_each_look_has_a_pose_for_each_part(target):
    view = next(views([target], 1))
    for name in ("shapes", "meshes"):
        look = robot_look(name)
        assert look.name == name and look is robot_look(name)
        assert look.poses(view.joints, view.T_base_ee).shape == (len(look.parts), 4, 4)


def test_shapes_are_those_that_every_camera_sees(target):
    view = next(views([target], 1))
    poses = robot_look("shapes").poses(view.joints, view.T_base_ee)
    seen = np.concatenate((arm_poses(view.joints[:7]), hand_poses(view.T_base_ee, view.joints[7:])))
    assert np.array_equal(poses, seen)


def test_without_the_package_the_shapes_are_shown_without_a_word():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert mesh_look(None) is robot_look("shapes")


@pytest.mark.pybullet
def test_a_damaged_file_is_told_of_in_one_line_and_the_shapes_are_shown(tmp_path):
    folder = shutil.copytree(str(meshes_folder()), tmp_path / "meshes")
    (folder / "visual" / "link3.obj").write_text("nonsense\n")
    with pytest.warns(UserWarning, match=r"shown by its shapes: .*link3\.obj is damaged") as told:
        assert mesh_look(folder) is robot_look("shapes")
    assert len(told) == 1 and "\n" not in str(told[0].message)


def test_another_name_is_refused():
    with pytest.raises(ConfigError, match="robot='mesh': give one of shapes, meshes"):
        RenderCamera(robot="mesh")  # pyright: ignore[reportArgumentType]


@pytest.mark.vulkan
@pytest.mark.parametrize("place", [{}, OVERHEAD], ids=["wrist", "overhead"])
def test_what_policies_see_does_not_change_by_what_people_are_shown(target, place):
    policy = RenderCamera(randomize=Randomization(), **place)
    film = RenderCamera(CameraIntrinsics(64, 64), T_base_camera=OVERHEAD["T_base_camera"], robot="meshes")
    states = list(views([target], 4))
    before = [policy.observe(view) for view in states]
    shown = [film.observe(view) for view in states]
    after = [policy.observe(view) for view in states]
    for one, other in zip(before, after, strict=True):
        assert all(np.array_equal(one[channel], other[channel]) for channel in one)
    assert all((picture["depth"] > 0).any() for picture in shown)


@pytest.mark.vulkan
@pytest.mark.pybullet
def test_meshes_stand_where_the_shapes_stand(target):
    views_of = {name: RenderCamera(rgb=False, robot=name, **OVERHEAD) for name in ("shapes", "meshes")}
    for view in views([target], 6):
        shapes, meshes = (camera.observe(view) for camera in views_of.values())
        assert not np.array_equal(shapes["depth"], meshes["depth"])
        # Where both see what is no table, they see it within a hand's breadth.
        off = np.abs(shapes["depth"] - meshes["depth"])
        assert np.mean(off > 0.1) < 0.1 and np.mean(shapes["mask"] != meshes["mask"]) < 0.02
