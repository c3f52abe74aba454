"""LeRobotDatasets, written and read by pyarrow; `with_real_library.py` does the same by LeRobot."""

import json
import sys
from io import BytesIO

import numpy as np
import pytest
import torch
from torchrl.envs import Compose

from tests.data.rollouts import append
from torchgrasp import keys
from torchgrasp.__main__ import main
from torchgrasp.data import (
    CompactTransitions,
    append_shard,
    begin_demonstrations,
    open_demonstrations,
    split_episodes,
)
from torchgrasp.data.lerobot.exchange import export_lerobot, import_lerobot
from torchgrasp.errors import ConfigError

pq = pytest.importorskip("pyarrow.parquet")
PICTURED = (keys.DEPTH, keys.MASK, keys.JOINTS, keys.T_BASE_EE, keys.T_BASE_CAMERA)


@pytest.fixture
def demonstrations(tmp_path):
    """Episodes of which some are truncated, in two shards."""
    begin_demonstrations(tmp_path / "demos", kind="failed", provenance={"seed": 3})
    for index in range(2):
        append(tmp_path / "demos", index)
    return open_demonstrations(tmp_path / "demos")


@pytest.fixture(scope="module")
def pictured(tmp_path_factory):
    """Episodes of the simulator with the pictures and poses of which clouds are made."""
    from torchgrasp.envs import GraspEnv
    from torchgrasp.objects import ProceduralObjects
    from torchgrasp.sim import CameraIntrinsics, RaycastCamera

    camera = RaycastCamera(intrinsics=CameraIntrinsics(width=24, height=24, fov=1.57, near=0.035, far=2.0))
    objects = ProceduralObjects("train", num_objects=1, num_grasps=100)
    env = GraspEnv(2, objects=objects, camera=camera, horizon=3, seed=0)
    rollout = env.rollout(3)
    codec = CompactTransitions(points_key=None, state_keys=(keys.TIME_LEFT, *PICTURED))
    folder = tmp_path_factory.mktemp("pictured") / "demos"
    begin_demonstrations(folder, kind="learner")
    names = [objects.names[0]] * 2
    append_shard(folder, split_episodes(rollout), objects=names, seeds=[0, 0], index=0, codec=codec)
    return open_demonstrations(folder), codec


def check_same(demonstrations, back):
    pairs = zip(demonstrations.iterate_episode_rows(), back.iterate_episode_rows(), strict=True)
    for (record, rows), (other_record, other) in pairs:
        assert record == other_record
        assert set(rows.keys(True, True)) == set(other.keys(True, True))
        for key in rows.keys(True, True):
            assert torch.equal(rows[key], other[key]) and rows[key].dtype == other[key].dtype, key


def test_everything_comes_back_row_for_row(demonstrations, tmp_path):
    assert any(bool(rows["stub"].any()) for rows in demonstrations.iterate_rows())
    export_lerobot(demonstrations, tmp_path / "grasps")
    card = import_lerobot(tmp_path / "grasps", tmp_path / "back")
    back = open_demonstrations(tmp_path / "back")
    assert back.card == card
    check_same(demonstrations, back)
    same = ("kind", "episodes", "successes", "attempts", "steps", "perturbed_steps", "objects", "seeds")
    assert {name: card[name] for name in same} == {name: demonstrations.card[name] for name in same}
    assert card["provenance"] == {"seed": 3, "imported_from": "grasps"}


def test_pictures_and_poses_come_back_and_clouds_are_made_of_them(pictured, tmp_path):
    from torchgrasp.transforms import DepthToPoints

    demonstrations, codec = pictured
    export_lerobot(demonstrations, tmp_path / "grasps")
    import_lerobot(tmp_path / "grasps", tmp_path / "back")
    back = open_demonstrations(tmp_path / "back")
    check_same(demonstrations, back)
    (rows,) = back.shards
    assert rows[keys.DEPTH].max() > 0 and rows[keys.MASK].any()
    to_points = Compose(DepthToPoints(fov=1.57))
    for before, after in zip(*(each.iterate_episodes(codec) for each in (demonstrations, back)), strict=True):
        clouds = [to_points(steps.exclude("next"))[keys.POINTS] for steps in (before, after)]
        assert torch.equal(*clouds) and clouds[0].abs().sum() > 0


def test_the_files_are_those_of_the_format(pictured, tmp_path):
    from PIL import Image

    demonstrations, _ = pictured
    folder = export_lerobot(demonstrations, tmp_path / "grasps")
    info = json.loads((folder / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] == pytest.approx(6.67, abs=0.01)
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (2, 6, 1)
    depth = info["features"]["observation.images.depth"]
    assert depth["shape"] == [24, 24, 1] and depth["info"] == {"is_depth_map": True, "depth_unit": "m"}
    frames = pq.read_table(folder / "data" / "chunk-000" / "file-000.parquet")
    assert set(frames.column_names) == set(info["features"])
    assert frames["frame_index"].to_pylist() == [0, 1, 2] * 2 and frames["index"].to_pylist() == [*range(6)]
    assert frames["timestamp"].to_pylist() == pytest.approx([0.0, 0.15, 0.3] * 2)
    (rows,) = demonstrations.shards
    for name, key in (("depth", keys.DEPTH), ("mask", keys.MASK)):
        for cell, value in zip(frames[f"observation.images.{name}"].to_pylist(), rows[key], strict=True):
            found = np.array(Image.open(BytesIO(cell["bytes"])))
            assert np.array_equal(found if name == "depth" else found == 255, value.numpy())
    assert np.array_equal(np.array(frames["observation.T_base_ee"].to_pylist()), rows[keys.T_BASE_EE].numpy())
    tasks = pq.read_table(folder / "meta" / "tasks.parquet").to_pylist()
    assert tasks == [{"task_index": 0, "task": next(iter(demonstrations.card["objects"]))}]


def test_statistics_are_those_of_all_frames(demonstrations, tmp_path):
    folder = export_lerobot(demonstrations, tmp_path / "grasps")
    statistics = json.loads((folder / "meta" / "stats.json").read_text())
    actions = torch.cat(list(demonstrations.iterate_episodes()))["action"].double()
    told = {name: torch.tensor(value) for name, value in statistics["action"].items()}
    assert torch.allclose(told["mean"].double(), actions.mean(0), atol=1e-6)
    assert torch.allclose(told["std"].double(), actions.std(0, correction=0), atol=1e-6)
    assert torch.equal(told["min"], actions.amin(0).float()) and told["count"].item() == len(actions)
    assert "observation.points" in json.loads((folder / "meta" / "info.json").read_text())["features"]
    (episodes,) = (folder / "meta" / "episodes").glob("*/*.parquet")
    first = pq.read_table(episodes).to_pylist()[0]
    steps = next(demonstrations.iterate_episodes())
    assert first["length"] == first["dataset_to_index"] == len(steps)
    assert first["stats/action/max"] == pytest.approx(steps["action"].amax(0).tolist())


def test_frames_go_on_in_further_files(demonstrations, tmp_path, monkeypatch):
    monkeypatch.setattr("torchgrasp.data.lerobot.dataset_writer._FILE_BYTES", 0)
    monkeypatch.setattr("torchgrasp.data.lerobot.dataset_writer._FILES", 3)
    folder = export_lerobot(demonstrations, tmp_path / "grasps")
    files = sorted(folder.glob("data/*/*.parquet"))
    assert len(files) == demonstrations.num_episodes and files[3].parent.name == "chunk-001"
    import_lerobot(folder, tmp_path / "back")
    check_same(demonstrations, open_demonstrations(tmp_path / "back"))


def test_nothing_is_written_over(demonstrations, tmp_path):
    folder = export_lerobot(demonstrations, tmp_path / "grasps")
    with pytest.raises(ConfigError, match="is there already"):
        export_lerobot(demonstrations, folder)
    with pytest.raises(ConfigError, match="is there already"):
        import_lerobot(folder, demonstrations.path)


def test_an_export_that_fails_leaves_nothing(demonstrations, tmp_path):
    wider = [steps.exclude("points", ("next", "points")) for steps in demonstrations.iterate_episodes()][:1]
    codec = CompactTransitions(points_key=None)
    card = append_shard(
        demonstrations.path, wider, objects=["mug"], seeds=[0], index=demonstrations.num_shards, codec=codec
    )
    assert card["shards"] == 3
    with pytest.raises(ConfigError, match="'points'"):
        export_lerobot(open_demonstrations(demonstrations.path), tmp_path / "grasps")
    assert {each.name for each in tmp_path.iterdir()} == {"demos"}


def test_what_a_killed_export_or_import_left_is_deleted_by_the_next(demonstrations, tmp_path):
    for name in (".grasps.new", ".back.new"):
        (tmp_path / name / "meta").mkdir(parents=True)
        (tmp_path / name / "meta" / "half.json").write_text("{")
    export_lerobot(demonstrations, tmp_path / "grasps")
    import_lerobot(tmp_path / "grasps", tmp_path / "back")
    assert {each.name for each in tmp_path.iterdir()} == {"demos", "grasps", "back"}
    assert not list(tmp_path.rglob("half.json"))


def test_the_command_exports_and_imports(demonstrations, tmp_path, capsys):
    path, dataset, again = str(demonstrations.path), str(tmp_path / "grasps"), str(tmp_path / "again")
    assert main(["dataset", path, "--format", "lerobot", "--export", dataset]) == 0
    assert f"Written to {dataset}" in capsys.readouterr().out
    command = ["dataset", again, "--format", "lerobot", "--import", dataset, "--kind", "learner"]
    assert main(command) == 0
    assert open_demonstrations(again).card["kind"] == "learner"
    assert main(["dataset", path, "--format", "lerobot"]) == 1
    assert "--format=lerobot goes with --export or --import" in capsys.readouterr().err


def test_without_pyarrow_one_line_tells_what_to_install(demonstrations, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = str(demonstrations.path)
    assert main(["dataset", path, "--format", "lerobot", "--export", str(tmp_path / "new")]) == 1
    assert 'pip install "torchgrasp[lerobot]"' in capsys.readouterr().err
