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


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("object/scale", np.nan, "object/scale=.*one factor"),
        ("object/scale", 1e300, "object/scale=.*one factor"),
        ("object/scale", [1.0, 2.0], "object/scale=.*one factor"),
        ("object/scale", b"large", "object/scale that is no number"),
        ("object/file", b"caf\xe9.obj", "names a mesh by .*fetch it again"),
        ("object/file", "x" * 5000, "names a mesh by|put the ShapeNetSem mesh there"),
        ("object/file", "/etc/passwd", "outside"),
        ("grasps/transforms", [[1.0]], r"transforms of shape \(1, 1\)"),
        ("grasps/transforms", 1.0, r"transforms of shape \(\)"),
        ("grasps/transforms", b"none", "transforms that is no number"),
    ],
)
def test_values_of_another_kind_are_named(tmp_path, crate, key, value, told):
    name = write_acronym(tmp_path)
    with h5py.File(tmp_path / "grasps" / f"{name}.h5", "a") as opened:
        del opened[key]
        opened[key] = value
    with pytest.raises(ObjectError, match=rf"(?s){name}\.h5.*{told}"):
        crate()[0]


def test_data_outside_the_file_or_beyond_memory_are_refused(tmp_path, crate):
    name = write_acronym(tmp_path)
    key, shape = "grasps/transforms", (240, 4, 4)

    def replaced(store, told):
        with h5py.File(tmp_path / "grasps" / f"{name}.h5", "a") as opened:
            if key in opened:
                del opened[key]
            store(opened)
        with pytest.raises(ObjectError, match=told):
            crate()[0]

    raw = str(tmp_path / "raw.bin")
    np.zeros(shape).tofile(raw)
    outside = [(raw, 0, h5py.h5f.UNLIMITED)]
    replaced(lambda f: f.create_dataset(key, shape, "f8", external=outside), "in another file")
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as opened:
        opened["t"] = np.zeros(shape)
    replaced(lambda f: f.__setitem__(key, h5py.ExternalLink(str(other), "t")), "in another file")
    layout = h5py.VirtualLayout(shape, "f8")
    layout[:] = h5py.VirtualSource(str(other), "t", shape)
    replaced(lambda f: f.create_virtual_dataset(key, layout), "in another file")
    huge = (10**9, 4, 4)
    replaced(lambda f: f.create_dataset(key, huge, "f8", chunks=(100, 4, 4)), "would take")


def test_meshes_may_lie_behind_a_link(tmp_path, crate):
    (tmp_path / "meshes").rename(tmp_path / "elsewhere")
    (tmp_path / "meshes").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "grasps" / "._x.h5").write_bytes(b"\0\5\x16\7")
    (item,) = crate()
    assert item.family == "Crate"
