"""Rows on disk are mapped for reading alone, once their sizes are what they are said to be."""

import json
import pickle
import shutil
from multiprocessing.reduction import ForkingPickler

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.data.mapped_rows import map_rows
from torchgrasp.errors import DamageError


@pytest.fixture
def folder(tmp_path):
    rows = TensorDict(
        {
            "points": torch.rand(5, 4, 3).half(),
            "a b/c%": torch.arange(5)[:, None],
            "camera": {"depth": torch.rand(5, 2)},
            "nothing": torch.zeros(5, 0),
        },
        [5],
    )
    rows.memmap(str(tmp_path / "rows"))
    return tmp_path / "rows"


def change(folder, name, **changes):
    meta = json.loads((folder / "meta.json").read_text())
    meta[name] = {**meta[name], **changes}
    (folder / "meta.json").write_text(json.dumps(meta))


def test_they_are_what_tensordict_reads(folder):
    mapped, expected = map_rows(folder, ""), TensorDict.load_memmap(folder)
    assert mapped.batch_size == expected.batch_size
    assert set(mapped.keys(True, True)) == set(expected.keys(True, True))
    for name in expected.keys(True, True):
        assert torch.equal(mapped[name], expected[name]) and mapped[name].dtype == expected[name].dtype


def test_nothing_that_is_done_to_them_reaches_the_files(folder):
    before = {file: file.read_bytes() for file in folder.rglob("*.*") if file.is_file()}
    for file in before:
        file.chmod(0o444)
    rows = map_rows(folder, "")
    rows["points"].zero_()
    rows["camera", "depth"][:] = 7.0
    assert {file: file.read_bytes() for file in folder.rglob("*.*") if file.is_file()} == before
    assert bool((map_rows(folder, "")["points"] != 0).any())


def test_a_larger_shape_is_refused_and_no_file_grows(folder):
    size = (folder / "points.memmap").stat().st_size
    for shape in ([5_000_000, 4, 3], [4, 4, 3], [2**53] * 3):
        change(folder, "points", shape=shape)
        with pytest.raises(DamageError, match=r"'points'.* bytes instead of|cannot be used"):
            map_rows(folder, "get it")
        assert (folder / "points.memmap").stat().st_size == size


def test_other_processes_are_given_the_files_name(folder):
    column = map_rows(folder, "")["points"]
    packed = bytes(ForkingPickler.dumps(column))
    assert len(packed) < 1000
    assert torch.equal(pickle.loads(packed), column)
    assert torch.equal(pickle.loads(bytes(ForkingPickler.dumps(column[2:4]))), column[2:4])


def test_missing_files_and_folders_are_named(folder):
    (folder / "points.memmap").unlink()
    with pytest.raises(DamageError, match=r"'points'.* has 0 bytes"):
        map_rows(folder, "get it")
    (folder / "points.memmap").write_bytes(bytes(5 * 4 * 3 * 2))
    shutil.rmtree(folder / "camera")
    with pytest.raises(DamageError, match="camera"):
        map_rows(folder, "get it")
    assert not len(map_rows(folder / "none", ""))
