"""LeRobotDatasets that others wrote, for good or ill."""

import contextlib
import json
import shutil

import numpy as np
import pytest
import torch

from tests.data.lerobot.foreign import LENGTHS, describe, draw_frames, picture, write_dataset
from tests.data.rollouts import append
from tests.hostile_values import check_each, check_texts
from torchgrasp import keys
from torchgrasp.data import CompactTransitions, begin_demonstrations, open_demonstrations
from torchgrasp.data.lerobot.exchange import export_lerobot, import_lerobot
from torchgrasp.errors import CheckpointError, ConfigError

pytest.importorskip("pyarrow")
TOTAL = sum(LENGTHS)
PICTURE = {"dtype": "image", "shape": [6, 8, 1], "names": ["height", "width", "channels"]}


def refuse(dataset, told, tmp_path, **options):
    with pytest.raises((CheckpointError, ConfigError), match=told) as error:
        import_lerobot(dataset, tmp_path / "imported", **options)
    assert "\n" not in str(error.value) and not (tmp_path / "imported").exists()


def test_datasets_of_others_come_without_labels(tmp_path):
    columns = draw_frames()
    card = import_lerobot(write_dataset(tmp_path / "other", columns), tmp_path / "demos", kind="expert")
    assert (card["episodes"], card["steps"], card["successes"], card["labelled_steps"]) == (2, TOTAL, 1, 0)
    assert set(card["objects"]) == {"lift the mug", "lift the bowl"}
    steps = torch.cat(list(open_demonstrations(tmp_path / "demos").iterate_episodes()))
    points = torch.from_numpy(columns["observation.points"]).half().float()
    assert torch.equal(steps["points"][:, :20, :3], points)
    assert torch.equal(steps["action"], torch.from_numpy(columns["action"]))
    assert steps["time_left"][:3, 0].tolist() == pytest.approx([1, 2 / 3, 1 / 3])


def test_depth_of_others_is_metres_whatever_it_is_stored_in(tmp_path):
    columns, generator = draw_frames(), np.random.default_rng(0)
    depth = generator.integers(0, 2000, (TOTAL, 6, 8)).astype(np.uint16)
    mask = generator.random((TOTAL, 6, 8)) < 0.5
    columns["observation.images.depth"] = [picture(each) for each in depth]
    columns["observation.images.mask"] = [picture(each.astype(np.uint8) * 255) for each in mask]
    told = {name: PICTURE for name in columns if "images" in name}
    codec = CompactTransitions(points_key=None, state_keys=(keys.DEPTH, keys.MASK))
    import_lerobot(write_dataset(tmp_path / "shorts", columns, told), tmp_path / "demos", codec=codec)
    (rows,) = open_demonstrations(tmp_path / "demos").shards
    assert torch.equal(rows[keys.DEPTH], torch.from_numpy((depth / 1000.0).astype(np.float32)))
    assert torch.equal(rows[keys.MASK], torch.from_numpy(mask))
    floats = [picture(each.astype(np.float32) / 1000, "TIFF") for each in depth]
    columns["observation.images.depth"] = floats
    import_lerobot(write_dataset(tmp_path / "floats", columns, told), tmp_path / "more", codec=codec)
    (again,) = open_demonstrations(tmp_path / "more").shards
    assert torch.allclose(again[keys.DEPTH], rows[keys.DEPTH], atol=1e-7)


def test_colours_and_a_second_camera_are_taken_where_the_codec_names_them(tmp_path):
    columns, generator = draw_frames(), np.random.default_rng(0)
    colours = generator.integers(0, 255, (TOTAL, 6, 8, 3)).astype(np.uint8)
    for name in ("rgb", "overhead_rgb"):
        columns[f"observation.images.{name}"] = [picture(each) for each in colours]
    told = {name: {**PICTURE, "shape": [6, 8, 3]} for name in columns if "images" in name}
    dataset = write_dataset(tmp_path / "other", columns, told)
    import_lerobot(dataset, tmp_path / "clouds")
    (rows,) = open_demonstrations(tmp_path / "clouds").shards
    assert not {keys.RGB, keys.OVERHEAD_RGB} & set(rows.keys(True, True))
    import_lerobot(dataset, tmp_path / "demos", codec=CompactTransitions(state_keys=(keys.RGB,)))
    (rows,) = open_demonstrations(tmp_path / "demos").shards
    assert torch.equal(rows[keys.RGB], torch.from_numpy(colours))
    assert keys.OVERHEAD_RGB not in rows.keys(True, True)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: c.pop("action"), r"no \['action'\]"),
        (lambda c: c.pop("observation.points"), r"no \['observation.points'\].*DepthToPoints"),
        (lambda c: c.pop("next.reward"), r"no \['next.reward'\]"),
        (lambda c: c.pop("task_index"), "'task_index'"),
        (lambda c: c.update(action=c["action"][:, :5]), r"'action' is told as float32 of shape \(5,\)"),
        (lambda c: c["action"].__setitem__(4, np.nan), "Episode 1: 'action' holds NaN"),
        (lambda c: c["observation.points"].__setitem__(4, 7e4), "Episode 1: 'observation.points' .*float16"),
        (lambda c: c.update(goal=np.zeros((TOTAL, 9))), r"'goal' is told as float64 of shape \(9,\)"),
        (lambda c: c.update(has_goal=np.full(TOTAL, 2)), "'has_goal' holds other values than 0 and 1"),
        (
            lambda c: c.update({"observation.time_left": np.full(TOTAL, 3.0)}),
            r"Episode 0: 'observation.time_left' is out of range",
        ),
        (lambda c: c.update({"next.done": np.ones(TOTAL, bool)}), "'next.done' is true at step 0 of 3"),
        (lambda c: c["frame_index"].__setitem__(1, 7), "frames of episode 0, or in another order"),
        (lambda c: c["episode_index"].__setitem__(slice(5, None), 2), "episode 1, or in another order"),
        (lambda c: c["task_index"].__setitem__(slice(None), 9), "has task 9"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path, change, told):
    columns = draw_frames()
    change(columns)
    refuse(write_dataset(tmp_path / "other", columns), told, tmp_path)


@pytest.mark.parametrize(
    ("cell", "feature", "told"),
    [
        (picture(np.zeros((6, 9), np.uint16)), PICTURE, r"6 x 9 pixels, not \(6, 8\)"),
        (picture(np.zeros((6, 8, 3), np.uint8)), PICTURE, "mode RGB"),
        ({"bytes": b"no picture", "path": None}, PICTURE, "cannot be used"),
        ({"bytes": None, "path": "/etc/passwd"}, PICTURE, "no picture inside"),
        (picture(np.full((6, 8), np.nan, np.float32), "TIFF"), PICTURE, "no numbers"),
        (picture(np.zeros((6, 8), np.uint16)), {**PICTURE, "dtype": "video"}, "told as video"),
        (
            picture(np.zeros((6, 8), np.uint16)),
            {**PICTURE, "shape": [1 << 20, 1 << 20, 1]},
            "numbers a frame",
        ),
        (3, PICTURE, "no pictures as files"),
    ],
)
def test_pictures_that_are_none_are_refused(tmp_path, cell, feature, told):
    columns = {**draw_frames(), "observation.images.depth": [cell] * TOTAL}
    dataset = write_dataset(tmp_path / "other", columns, {"observation.images.depth": feature})
    codec = CompactTransitions(points_key=None, state_keys=(keys.DEPTH,))
    refuse(dataset, told, tmp_path, codec=codec)


def test_a_file_that_tells_of_other_shapes_or_too_much_is_refused(tmp_path):
    columns = draw_frames()
    features = describe(columns)
    features["observation.points"]["shape"] = [30, 3]
    refuse(write_dataset(tmp_path / "shapes", columns, features), r"no numbers of shape \(30, 3\)", tmp_path)
    features["observation.points"]["shape"] = [1, 3]
    columns["observation.points"] = [[[0.0, 0.0, 0.0]] * 300_000] * TOTAL
    refuse(write_dataset(tmp_path / "much", columns, features), "would take .* bytes or more", tmp_path)


def test_another_version_or_no_dataset_is_one_line(tmp_path):
    dataset = write_dataset(tmp_path / "old", draw_frames(), codebase_version="v2.1")
    refuse(dataset, "version v2.1, v3.0 is read here", tmp_path)
    refuse(tmp_path / "none", "no LeRobotDataset at", tmp_path)
    refuse(write_dataset(tmp_path / "empty", draw_frames(), total_episodes=0), "holds no episode", tmp_path)
    half = write_dataset(tmp_path / "half", draw_frames())
    shutil.rmtree(half / "data")
    refuse(half, "hold 0 episodes, meta/episodes tells of 2", tmp_path)
    (half / "meta" / "tasks.parquet").unlink()
    refuse(half, "tasks.parquet is missing", tmp_path)


def test_hostile_metadata_is_refused(tmp_path):
    dataset = write_dataset(tmp_path / "other", draw_frames())
    file = dataset / "meta" / "info.json"
    info = json.loads(file.read_text())

    def read():
        shutil.rmtree(tmp_path / "demos", ignore_errors=True)
        import_lerobot(dataset, tmp_path / "demos")

    unread = ("fps", "features.timestamp", "features.index", "features.frame_index")
    unread += ("features.episode_index", "features.task_index")

    def free(words):  # what is not read
        return words.startswith(unread) or ".names" in words or words.endswith("more") or "reward" in words

    assert check_each(info, lambda value: file.write_text(json.dumps(value)), read, free=free) > 30
    check_texts(file, read)


@pytest.fixture
def export(tmp_path):
    begin_demonstrations(tmp_path / "demos", kind="failed")
    append(tmp_path / "demos", 0)
    return export_lerobot(open_demonstrations(tmp_path / "demos"), tmp_path / "grasps")


def test_an_export_that_was_changed_is_refused(export, tmp_path):
    file = export / "meta" / "torchgrasp.json"
    told = json.loads(file.read_text())
    changes = {
        "frames": 3,
        "format": 2,
        "card": {**told["card"], "attempts": 10**30},
        "columns": {**told["columns"], "more": {"key": ["x"], "dtype": "float32", "shape": [1]}},
    }
    for name, value in changes.items():
        file.write_text(json.dumps({**told, name: value}))
        refuse(export, r"torchgrasp\.json", tmp_path)
    for name, column in told["columns"].items():
        for wrong in ({"shape": [10**9]}, {"shape": [3, 1]}, {"dtype": "float64"}, {"key": []}):
            columns = {**told["columns"], name: {**column, **wrong}}
            file.write_text(json.dumps({**told, "columns": columns}))
            with contextlib.suppress(CheckpointError, ConfigError):  # another type may hold the same
                import_lerobot(export, tmp_path / "imported")
                shutil.rmtree(tmp_path / "imported")


def test_a_damaged_file_is_one_line(export, tmp_path):
    for file in export.rglob("*.parquet"):
        content, data = file.read_bytes(), file.parts[-3] == "data"
        file.write_bytes(content[: len(content) // 2])
        refuse(export, "cannot be read", tmp_path)
        refused = 0
        for place in range(0, len(content), max(1, len(content) // 25)):
            changed = bytearray(content)
            changed[place] ^= 0xFF
            file.write_bytes(changed)
            shutil.rmtree(tmp_path / "imported", ignore_errors=True)
            try:
                import_lerobot(export, tmp_path / "imported")
            except (CheckpointError, ConfigError):
                refused += 1
        assert refused > 10 or not data
        shutil.rmtree(tmp_path / "imported", ignore_errors=True)
        file.write_bytes(content)
