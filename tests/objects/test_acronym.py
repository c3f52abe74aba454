import h5py
import numpy as np
import pytest

from tests.objects.acronym_files import CENTRE, SIZE, write_acronym
from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects import AcronymObjects
from torchgrasp.sim import Physics
from torchgrasp.sim.grasp_proof import grasp_holds


@pytest.fixture
def crate(tmp_path):
    write_acronym(tmp_path)
    return lambda **options: AcronymObjects(tmp_path, cache_dir=tmp_path / "cache", num_grasps=100, **options)


def test_the_scaled_mesh_and_its_successful_grasps_are_kept(crate):
    (item,) = crate()
    assert item.family == "Crate" and item.licence == "CC BY-NC 4.0"
    assert item.size == pytest.approx(SIZE, abs=1e-6)
    assert item.centre_of_mass == pytest.approx(CENTRE, abs=1e-6)
    assert len(item.grasps) == 100
    # Closing along the box's x by y of the hand, pads within three millimetres of the middle.
    assert np.abs(item.grasps[:, 0, 1]) == pytest.approx(np.ones(100), abs=1e-6)
    tips = item.grasps[:, :3, 3] + 0.1034 * item.grasps[:, :3, 2]
    assert np.abs(tips).max() < 0.0031
    assert np.array_equal(item.grasps[1::2, :3, 3], item.grasps[::2, :3, 3])


def test_converted_grasps_lift_in_physics_and_farther_ones_do_not(crate):
    (item,) = crate()
    away = np.eye(4)
    away[2, 3] = -0.08
    for grasp in item.grasps[:12:4].astype(np.float64):
        assert grasp_holds(item, grasp, Physics())
        assert not grasp_holds(item, grasp @ away, Physics())


def test_what_is_missing_or_damaged_is_named(tmp_path, crate):
    name = write_acronym(tmp_path)
    file = tmp_path / "grasps" / f"{name}.h5"
    with pytest.raises(ObjectError, match=r"nowhere.grasps holds no \.h5"):
        AcronymObjects(tmp_path / "nowhere")
    with pytest.raises(ObjectError, match=f"'other'.*{name}"):
        crate(include=["other"])
    with pytest.raises(ObjectError, match=r"has \d+ grasps where min_grasps=300"):
        AcronymObjects(tmp_path, cache_dir=tmp_path / "c", min_grasps=300)[0]
    with pytest.raises(ConfigError, match="split='all'"):
        crate(split="all")
    with h5py.File(file, "a") as opened:
        del opened["grasps/qualities"]
    with pytest.raises(ObjectError, match=r"grasps/qualities/flex/object_in_gripper"):
        crate()[0]
    with h5py.File(file, "a") as opened:
        del opened["object/file"]
        opened["object/file"] = "../elsewhere.obj"
    with pytest.raises(ObjectError, match="outside"):
        crate()
    (tmp_path / "meshes" / "Crate" / "abc.obj").unlink()
    write_acronym(tmp_path)
    (tmp_path / "meshes" / "Crate" / "abc.obj").unlink()
    with pytest.raises(ObjectError, match=r"put the ShapeNetSem mesh there"):
        crate()
    file.write_bytes(b"no h5 file")
    with pytest.raises(ObjectError, match="fetch it again"):
        crate()
