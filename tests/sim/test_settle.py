import numpy as np
import pytest
import trimesh

from torchgrasp.objects import FolderObjects, ProceduralObjects
from torchgrasp.sim import Physics, Placement, SapienEngine
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.settle import prepare_resting, settle, settled_poses

OBJECTS = ProceduralObjects("train", num_objects=8, num_grasps=100)


@pytest.mark.parametrize("index", range(8))
def test_settled_poses_stay_still(index):
    target = OBJECTS[index]
    poses = settle(target, Physics())
    assert len(poses)
    for pose in poses[:4]:
        start = pose.copy()
        start[:2, 3] = 0.6, 0.3
        world = SapienEngine().build(Placement(target, start, kin.READY_POSTURE, Physics()))
        for _ in range(20):  # 3 s
            world.drive(kin.READY_POSTURE)
        drift = world.T_base_object - start
        assert np.abs(drift[:3, 3]).max() < 5e-3
        assert np.abs(drift[:3, :3]).max() < 0.1


def test_a_brick_rests_on_its_three_kinds_of_faces(brick):
    poses = settle(brick, Physics())
    heights = sorted(round(float(z), 4) for z in poses[:, 2, 3])
    assert heights == pytest.approx([0.025, 0.025, 0.03, 0.03, 0.04, 0.04], abs=2e-4)
    assert np.all(poses[:, :2, 3] == 0.0)


def test_settled_poses_lie_on_the_table_and_differ_in_tilt(can):
    poses = settle(can, Physics())
    lowest = [(can.vertices @ pose[:3, :3].T + pose[:3, 3])[:, 2].min() for pose in poses]
    assert lowest == pytest.approx(np.zeros(len(poses)), abs=2e-3)
    up = poses[:, 2, :3]
    angles = np.arccos(np.clip(up @ up.T, -1, 1))[np.triu_indices(len(poses), 1)]
    assert np.all(angles >= 0.05)


def test_settling_is_repeatable(can):
    assert np.array_equal(settle(can, Physics()), settle(can, Physics()))


def test_settled_poses_are_computed_once_for_what_matters(can, tmp_path, monkeypatch):
    first = settled_poses(can, Physics(), cache_dir=tmp_path)
    assert np.array_equal(first, settle(can, Physics()))
    settled_poses(can, Physics(friction=0.5), cache_dir=tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    monkeypatch.setattr("torchgrasp.sim.settle.settle", lambda *_: pytest.fail("settled although cached"))
    again = settled_poses(can, Physics(finger_friction=1.0, lift_height=0.2), cache_dir=tmp_path)
    assert np.array_equal(first, again)


def test_a_damaged_file_of_poses_is_made_again(can, tmp_path):
    first = settled_poses(can, Physics(), cache_dir=tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(b"nothing")
    with pytest.warns(UserWarning, match="damaged"):
        assert np.array_equal(first, settled_poses(can, Physics(), cache_dir=tmp_path))


def test_preparing_passes_over_what_cannot_be_used(tmp_path):
    meshes, cache = tmp_path / "meshes", tmp_path / "cache"
    meshes.mkdir()
    trimesh.creation.box((0.04, 0.05, 0.12)).export(meshes / "box.stl")
    trimesh.creation.box((0.2, 0.2, 0.2)).export(meshes / "crate.stl")
    objects = FolderObjects(meshes, num_grasps=100, cache_dir=cache)
    prepare_resting(objects, Physics(), cache_dir=tmp_path / "resting", progress=False)
    assert [path.suffix for path in sorted(cache.iterdir())] == [".npz", ".refused"]
    assert len(list((tmp_path / "resting").iterdir())) == 1
    assert "0 grasps" in (objects.refusal(1) or "") and objects.refusal(0) is None
    assert objects.missing() == []
