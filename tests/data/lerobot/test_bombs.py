"""Small files that would become large: LeRobotDatasets whose entries many frames share, or that run on."""

import json
import shutil
import tracemalloc

import numpy as np
import pytest
import torch

from tests.data.lerobot.foreign import COUNTERS, LENGTHS, draw_frames, picture, write_dataset
from torchgrasp import keys
from torchgrasp.data import CompactTransitions, open_demonstrations
from torchgrasp.data.lerobot.exchange import import_lerobot
from torchgrasp.errors import CheckpointError, ConfigError

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
TOTAL = sum(LENGTHS)
DEPTH = "observation.images.depth"
PICTURE = {"dtype": "image", "shape": [6, 8, 1], "names": ["height", "width", "channels"]}
PICTURED = CompactTransitions(points_key=None, state_keys=(keys.DEPTH,))


def refuse(dataset, told, tmp_path, *, most=24 << 20, **options):
    """Refused by one line; meanwhile few bytes are held beside the 16 MB that reading JSON takes."""
    held = pa.total_allocated_bytes()
    tracemalloc.start()
    try:
        with pytest.raises((CheckpointError, ConfigError), match=told) as error:
            import_lerobot(dataset, tmp_path / "imported", **options)
        assert tracemalloc.get_traced_memory()[1] < most and pa.total_allocated_bytes() < held + most
    finally:
        tracemalloc.stop()
    assert "\n" not in str(error.value) and not (tmp_path / "imported").exists()


def write(dataset, name, columns):
    """A table of the dataset in place of what is there; returns its bytes."""
    file = dataset / name
    table = columns if isinstance(columns, pa.Table) else pa.table(columns)
    pq.write_table(table, file, compression="zstd")
    return file.stat().st_size


def pictured(folder, cell):
    columns = {**draw_frames(), DEPTH: [cell] * TOTAL}
    return write_dataset(folder, columns, {DEPTH: PICTURE})


def test_tasks_are_short_and_no_more_than_frames(tmp_path):
    dataset, file = write_dataset(tmp_path / "other", draw_frames()), "meta/tasks.parquet"
    small = write(dataset, file, {"task_index": range(100), "task": ["x" * 1_000_000] * 100})
    assert small < 5000
    refuse(dataset, "'task' has an entry of 1000000 bytes, at most 4096 fit", tmp_path)
    write(dataset, file, {"task_index": [0, 1], "task": ["mug", "é" * 2049]})
    refuse(dataset, "'task' has an entry of 4098 bytes", tmp_path)
    write(dataset, file, {"task_index": np.arange(100_000), "task": ["x"] * 100_000})
    refuse(dataset, "more tasks than the dataset has frames", tmp_path)
    write(dataset, file, {"task_index": range(3), "task": pa.array([1, 2, 3])})
    refuse(dataset, "no pictures as files or texts", tmp_path)
    texts = pa.array([b"m\xffg", "é".encode() * 2048, None], pa.binary())
    write(dataset, file, {"task_index": range(3), "task": texts})
    objects = import_lerobot(dataset, tmp_path / "imported")["objects"]
    assert set(objects) == {"m\ufffdg", "é" * 1000}


def test_texts_told_by_their_beginnings_are_refused(tmp_path):
    dataset = write_dataset(tmp_path / "other", draw_frames())
    table = pa.table({"task_index": [0, 1], "task": ["mug", "mugs"]})
    encoding = {"task": "DELTA_BYTE_ARRAY"}
    file = dataset / "meta" / "tasks.parquet"
    pq.write_table(table, file, use_dictionary=False, column_encoding=encoding)
    refuse(dataset, "stored by DELTA_BYTE_ARRAY", tmp_path)


def test_a_picture_of_many_bytes_is_refused_and_one_that_frames_share_is_there_once(tmp_path):
    good = picture(np.full((6, 8), 700, np.uint16))
    dataset = pictured(tmp_path / "large", {"bytes": good["bytes"] + bytes(500_000), "path": None})
    file = "data/chunk-000/file-000.parquet"
    frame = pq.read_table(dataset / file)[:1]
    columns = pa.concat_tables([frame] * 300)
    assert write(dataset, file, columns) < 20_000
    refuse(dataset, f"Episode 0: '{DEPTH}' has an entry of 500", tmp_path, codec=PICTURED)
    import_lerobot(pictured(tmp_path / "good", good), tmp_path / "demos", codec=PICTURED)
    (rows,) = open_demonstrations(tmp_path / "demos").shards
    assert torch.equal(rows[keys.DEPTH], torch.full((TOTAL, 6, 8), 0.7))


def test_pictures_files_count_among_what_an_episode_takes(tmp_path, monkeypatch):
    good = picture(np.full((6, 8), 700, np.uint16))
    dataset = pictured(tmp_path / "some", {"bytes": good["bytes"] + bytes(60_000), "path": None})
    monkeypatch.setattr("torchgrasp.data.lerobot.episode_frames._MOST_BYTES", 250_000)
    refuse(dataset, "Episode 1 takes more than 250000 bytes", tmp_path, codec=PICTURED)


def test_pictures_are_read_over_row_groups(tmp_path):
    columns, depth = draw_frames(), np.arange(TOTAL * 48, dtype=np.uint16).reshape(TOTAL, 6, 8)
    dataset = write_dataset(
        tmp_path / "other", {**columns, DEPTH: [picture(each) for each in depth]}, {DEPTH: PICTURE}
    )
    file = dataset / "data" / "chunk-000" / "file-000.parquet"
    pq.write_table(pq.read_table(file), file, row_group_size=2)
    import_lerobot(dataset, tmp_path / "demos", codec=PICTURED)
    (rows,) = open_demonstrations(tmp_path / "demos").shards
    assert torch.equal(rows[keys.DEPTH], torch.from_numpy((depth / 1000.0).astype(np.float32)))


def test_episodes_are_counted_as_they_are_read(tmp_path):
    dataset = write_dataset(tmp_path / "other", draw_frames())
    file, many = "meta/episodes/chunk-000/file-000.parquet", 3_000_000
    small = write(dataset, file, {"episode_index": np.zeros(many, int), "length": np.ones(many, int)})
    assert small < 50_000
    info = dataset / "meta" / "info.json"
    told = json.loads(info.read_text())
    for total, reason in ((2**53, "at most 262144"), (1 << 18, "in another order")):
        info.write_text(json.dumps({**told, "total_episodes": total, "total_frames": many}))
        refuse(dataset, reason, tmp_path)
    info.write_text(json.dumps(told))
    write(dataset, file, {"episode_index": range(4), "length": [3, 5, 1, 1]})
    refuse(dataset, "more episodes than the 2 of", tmp_path)
    write(dataset, file, {"episode_index": [0], "length": [TOTAL]})
    refuse(dataset, "tells of 1 episodes, meta/info.json of 2", tmp_path)


def test_one_row_that_runs_on_is_refused(tmp_path):
    columns = draw_frames()
    columns["action"] = [[0.5] * 6] * (TOTAL - 1) + [[0.5] * 20_000]
    told = {"action": {"dtype": "float64", "shape": [6], "names": None}}
    dataset = write_dataset(tmp_path / "other", columns, told)
    refuse(dataset, r"'action' of 8 frames would take \d+ bytes or more", tmp_path)


@pytest.mark.parametrize("fixed", [False, True])
def test_a_number_may_be_a_list_of_one(tmp_path, fixed):
    columns = draw_frames()
    plain = import_lerobot(write_dataset(tmp_path / "plain", columns), tmp_path / "expected")
    dataset = write_dataset(tmp_path / "other", columns)
    file = dataset / "data" / "chunk-000" / "file-000.parquet"
    table = pq.read_table(file)
    for name in (*COUNTERS, "next.reward"):
        values = table[name].combine_chunks()
        lists = pa.FixedSizeListArray.from_arrays(values, 1)
        lists = lists if fixed else lists.cast(pa.list_(values.type))
        table = table.set_column(table.column_names.index(name), name, lists)
    pq.write_table(table, file)
    assert import_lerobot(dataset, tmp_path / "demos")["successes"] == plain["successes"] == 1
    pairs = (open_demonstrations(tmp_path / name).shards[0] for name in ("expected", "demos"))
    before, after = pairs
    assert bool((before == after).all())
    shutil.rmtree(tmp_path / "demos")
    two = pa.array([[1.0, 2.0]] * TOTAL, pa.list_(pa.float32()))
    pq.write_table(table.set_column(table.column_names.index("next.reward"), "next.reward", two), file)
    refuse(dataset, r"'next.reward' holds no numbers of shape \(1,\)", tmp_path)
