"""The Panda's meshes of an installed pybullet: where each link is, and what of its files is refused."""

import shutil
import sys
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from torchgrasp.errors import ObjectError
from torchgrasp.objects.surface import face_normals
from torchgrasp.sim.kinematics import JOINT_LOWER, JOINT_UPPER, forward_kinematics
from torchgrasp.sim.panda_meshes import FILES, PandaMeshes, link_frames, meshes_folder, read_meshes
from torchgrasp.sim.panda_pose import ARM_SIZES, arm_poses
from torchgrasp.sim.panda_tables import FINGER_SHAPES, HAND_SHAPES, Shape

pytestmark = pytest.mark.pybullet

LINKS = [*(f"panda_link{i}" for i in range(8)), "panda_hand", "panda_leftfinger", "panda_rightfinger"]


@pytest.fixture(scope="module")
def folder() -> Path:
    found = meshes_folder()
    assert found is not None, (
        'these tests need the extra random-urdfs: pip install "torchgrasp[random-urdfs]"'
    )
    return found


@pytest.fixture(scope="module")
def urdf(folder) -> Element:
    return ElementTree.parse(folder.parent / "panda.urdf").getroot()


@pytest.fixture(scope="module")
def meshes(folder) -> PandaMeshes:
    return read_meshes(folder)


def origin(element: Element) -> np.ndarray:
    """(4, 4) what a URDF's <origin> says."""
    pose, found = np.eye(4), element.find("origin")
    if found is not None:
        pose[:3, 3] = np.fromstring(found.get("xyz", "0 0 0"), sep=" ")
        turn = np.fromstring(found.get("rpy", "0 0 0"), sep=" ")
        pose[:3, :3] = Rotation.from_euler("xyz", turn).as_matrix()
    return pose


def urdf_poses(urdf: Element, joints: np.ndarray) -> np.ndarray:
    """(11, 4, 4) poses of what panda.urdf shows at (9,) joints: links 0 to 7, hand, fingers."""
    moved = {f"panda_joint{i + 1}": joints[i] for i in range(7)}
    moved |= {f"panda_finger_joint{i + 1}": joints[7 + i] for i in range(2)}
    poses = {"panda_link0": np.eye(4)}
    waiting = list(urdf.iter("joint"))
    while waiting:
        joint = waiting.pop(0)
        parent, child = joint.find("parent").get("link"), joint.find("child").get("link")  # pyright: ignore
        if parent not in poses:
            waiting.append(joint)
            continue
        move = np.eye(4)
        if joint.get("type") != "fixed":
            along = moved[joint.get("name")] * np.fromstring(joint.find("axis").get("xyz"), sep=" ")  # pyright: ignore
            if joint.get("type") == "prismatic":
                move[:3, 3] = along
            else:
                move[:3, :3] = Rotation.from_rotvec(along).as_matrix()
        poses[child] = poses[parent] @ origin(joint) @ move  # pyright: ignore
    shown = {link.get("name"): link.find("visual") for link in urdf.iter("link")}
    return np.stack([poses[name] @ origin(shown[name]) for name in LINKS])  # pyright: ignore


def bounds(meshes: PandaMeshes, link: int) -> np.ndarray:
    """(2, 3) lower and upper ends of a link's mesh, link frame."""
    parts = [part for part, each in zip(meshes.parts, meshes.links, strict=True) if each == link]
    corners = np.concatenate([part.visual.vertices for part in parts])
    return np.stack((corners.min(0), corners.max(0)))


def shape_bounds(shapes: tuple[Shape, ...]) -> np.ndarray:
    """(2, 3) lower and upper ends of shapes, link frame."""
    ends = []
    for shape in shapes:
        if len(shape.size) == 2:
            radius, length = shape.size
            reach = np.abs(shape.rotation[:, 2]) * length / 2 + radius
        else:
            reach = np.abs(shape.rotation) @ np.array(shape.size) / 2
        ends += [shape.position - reach, shape.position + reach]
    return np.stack((np.min(ends, axis=0), np.max(ends, axis=0)))


def test_links_are_where_the_packages_robot_has_them(urdf):
    rng = np.random.default_rng(0)
    for _ in range(30):
        joints = np.concatenate((rng.uniform(JOINT_LOWER, JOINT_UPPER), rng.uniform(0.0, 0.04, 2)))
        frames = link_frames(joints, forward_kinematics(joints[None, :7])[0])
        assert np.allclose(frames, urdf_poses(urdf, joints), atol=1e-9)


def test_each_link_shows_the_file_that_the_packages_robot_shows(urdf):
    shown = {link.get("name"): link.find("visual/geometry/mesh") for link in urdf.iter("link")}
    names = [shown[name].get("filename").removeprefix("package://meshes/") for name in LINKS]  # pyright: ignore
    assert names == list(FILES)


def test_hand_and_fingers_are_as_large_as_what_collides(meshes):
    hand = bounds(meshes, 8) - shape_bounds(HAND_SHAPES)
    assert np.abs(hand).max() < 0.004
    for finger in (9, 10):  # both meshes are the left one; the right one's frame turns it
        assert np.abs(bounds(meshes, finger) - shape_bounds(FINGER_SHAPES)).max() < 0.0015


def beyond(points: np.ndarray, size: tuple[float, ...], pose: np.ndarray) -> np.ndarray:
    """(N,) metres by which base-frame points (N, 3) lie outside a shape."""
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    if len(size) == 3:
        return np.linalg.norm(np.maximum(np.abs(local) - np.array(size) / 2, 0.0), axis=-1)
    radius, length = size
    local[:, 2] -= np.clip(local[:, 2], -length / 2, length / 2)
    return np.maximum(np.linalg.norm(local, axis=-1) - radius, 0.0)


def test_the_arm_lies_about_what_collides(meshes):
    for joints in np.random.default_rng(1).uniform(JOINT_LOWER, JOINT_UPPER, (3, 7)):
        poses = meshes.poses(np.array([*joints, 0.0, 0.0]), forward_kinematics(joints[None])[0])
        shapes = list(zip(ARM_SIZES, arm_poses(joints), strict=True))
        for part, link, pose in zip(meshes.parts, meshes.links, poses, strict=True):
            if link < 8:
                points = part.visual.vertices @ pose[:3, :3].T + pose[:3, 3]
                outside = np.min([beyond(points, *shape) for shape in shapes], axis=0)
                assert outside.max() < 0.06 and outside.mean() < 0.025


def test_the_pads_meet_where_the_boxes_meet(meshes):
    joints = np.array([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.8, 0.0, 0.0])
    frames = link_frames(joints, np.eye(4))
    left, right = (frames[link, 1, :3] @ bounds(meshes, link).T + frames[link, 1, 3] for link in (9, 10))
    assert left.min() == pytest.approx(0.0, abs=1e-3) and right.max() == pytest.approx(0.0, abs=1e-3)


def test_surfaces_are_seen_from_outside_alone(meshes):
    finger = meshes.parts[-1].visual
    triangles = finger.vertices[finger.faces].astype(np.float64)
    normals, areas = face_normals(finger.vertices, finger.faces)
    middle = triangles.reshape(-1, 3).mean(0)
    assert ((triangles.mean(1) - middle) * normals).sum(-1) @ areas > 0
    assert {part.colour for part in meshes.parts} >= {(1.0, 1.0, 1.0), (64 / 255,) * 3}


@pytest.fixture
def copied(folder, tmp_path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "meshes"))


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:9000])


def without_faces(file: Path) -> None:
    file.write_text("v 0 0 0\nv 0 0 1\nv 0 1 0\n")


def in_millimetres(file: Path) -> None:
    file.write_text("v 0 0 0\nv 0 0 100\nv 0 100 0\nusemtl Part__Feature_007.001\nf 1 2 3\n")


def with_nan(file: Path) -> None:
    text = "v 0 0 0\nv 0 0 nan\nv 0 0.1 0\nusemtl Part__Feature_007.001\nf 1 2 3\n"
    file.write_text(text)


def of_other_vertices(file: Path) -> None:
    file.write_text("v 0 0 0\nusemtl Part__Feature_007.001\nf 7 8 9\n")


def of_another_colour(file: Path) -> None:
    file.write_text("mtllib finger.mtl\nv 0 0 0\nv 0 0 0.1\nv 0 0.1 0\nusemtl unknown\nf 1 2 3\n")


DAMAGE = (Path.unlink, cut, without_faces, in_millimetres, with_nan, of_other_vertices, of_another_colour)


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage.__name__)
def test_a_file_that_cannot_be_used_is_named(copied, damage):
    damage(copied / "visual" / "finger.obj")
    with pytest.raises(ObjectError, match=r"finger\.obj .*: (install pybullet again|restore it)\.$") as told:
        read_meshes(copied)
    assert "\n" not in str(told.value)


def test_missing_colours_are_named(copied):
    (copied / "visual" / "hand.mtl").unlink()
    with pytest.raises(ObjectError, match=r"hand\.mtl cannot be read"):
        read_meshes(copied)


def test_the_package_is_not_imported_and_may_be_missing(monkeypatch):
    assert "pybullet" not in sys.modules and "pybullet_data" not in sys.modules
    monkeypatch.setitem(sys.modules, "pybullet_data", None)
    assert meshes_folder() is None
