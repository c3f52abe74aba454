import multiprocessing
import os
import pickle
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.objects.cache import default_cache_dir, refusal_path
from torchgrasp.objects.families import HELD_OUT, TRAINED


def test_names_are_unique_and_families_take_turns():
    for split in ("train", "val", "test"):
        objects = ProceduralObjects(split, num_objects=25)
        assert len(objects) == len(set(objects.names)) == 25
        families = {name.split("-")[0] for name in objects.names}
        assert families == set(TRAINED) | (set(HELD_OUT) if split == "test" else set())


def test_splits_share_no_object(cache_dir):
    hashes = [
        item.content_hash
        for split in ("train", "val", "test")
        for item in ProceduralObjects(
            split, num_objects=3, families=["box", "mug", "bowl"], cache_dir=cache_dir
        )
    ]
    assert len(set(hashes)) == 9


def test_same_seed_same_objects_and_longer_sets_begin_alike(tmp_path):
    short = ProceduralObjects("val", num_objects=2, seed=7, cache_dir=tmp_path / "a")
    long = ProceduralObjects("val", num_objects=4, seed=7, cache_dir=tmp_path / "b")
    other = ProceduralObjects("val", num_objects=2, seed=8, cache_dir=tmp_path / "a")
    assert [item.content_hash for item in short] == [item.content_hash for item in long[:2]]
    assert short.names == long.names[:2]
    assert short[0].content_hash != other[0].content_hash


def test_a_second_set_reads_what_the_first_one_built(tmp_path, monkeypatch):
    first = ProceduralObjects("train", num_objects=1, cache_dir=tmp_path)[0]
    again = ProceduralObjects("train", num_objects=1, cache_dir=tmp_path)
    monkeypatch.setattr(again, "_build", lambda index: pytest.fail("built although cached"))
    again.prepare()
    second = again[-1]
    assert second.content_hash == first.content_hash and second.licence == "MIT, procedural"
    for name in ("vertices", "faces", "grasps", "grasp_quality", "resting_poses", "resting_probability"):
        assert np.array_equal(getattr(first, name), getattr(second, name))
        assert getattr(first, name).dtype == getattr(second, name).dtype
    assert all(np.array_equal(a, b) for a, b in zip(first.parts, second.parts, strict=True))


@pytest.mark.parametrize("damage", [b"", b"not a zip", None])
def test_a_damaged_file_is_built_again_with_a_warning(tmp_path, damage):
    good = ProceduralObjects("train", num_objects=1, num_grasps=100, cache_dir=tmp_path)[0]
    (file,) = tmp_path.glob("*.npz")
    file.write_bytes(file.read_bytes()[:-2000] if damage is None else damage)
    with pytest.warns(UserWarning, match="damaged"):
        mended = ProceduralObjects("train", num_objects=1, num_grasps=100, cache_dir=tmp_path)[0]
    assert mended.content_hash == good.content_hash
    assert ProceduralObjects("train", num_objects=1, num_grasps=100, cache_dir=tmp_path)[0] is not mended


def rewrite(file, **changes):
    with np.load(file) as stored:
        arrays = {name: stored[name] for name in stored.files}
    np.savez(file, **{**arrays, **changes})


def claim_terabytes(file):
    """An array whose header tells of 8 TB."""
    with zipfile.ZipFile(file, "a") as archive, archive.open("more.npy", "w") as stream:
        np.lib.format.write_array_header_1_0(
            stream, {"shape": (10**12,), "fortran_order": False, "descr": "<f8"}
        )


def compress(file):
    with np.load(file) as stored:
        np.savez_compressed(file, **{name: stored[name] for name in stored.files})


@pytest.mark.parametrize(
    "damage",
    [
        claim_terabytes,
        compress,
        lambda file: rewrite(file, faces=np.full((4, 3), 10**6, np.int32)),
        lambda file: rewrite(file, part_sizes=np.array([10**12, 1])),
        lambda file: rewrite(file, grasps=np.zeros((0, 4, 4), np.float32)),
    ],
)
def test_a_file_of_other_arrays_is_built_again_with_a_warning(tmp_path, damage):
    good = ProceduralObjects("train", num_objects=1, num_grasps=100, cache_dir=tmp_path)[0]
    (file,) = tmp_path.glob("*.npz")
    damage(file)
    with pytest.warns(UserWarning, match="damaged"):
        mended = ProceduralObjects("train", num_objects=1, num_grasps=100, cache_dir=tmp_path)[0]
    assert mended.content_hash == good.content_hash


def test_a_damaged_note_of_a_refusal_is_told(tmp_path):
    objects = ProceduralObjects("train", num_objects=1, num_grasps=100, cache_dir=tmp_path)
    refusal_path(objects._cache_path(0)).write_bytes(b"\xff\xfe")
    with pytest.raises(ObjectError, match=r"refused cannot be used .*delete it"):
        objects[0]
    assert "delete it" in (objects.refusal(0) or "")


def _hashes(cache_dir, start, answers):
    start.wait()
    objects = ProceduralObjects("test", num_objects=3, num_grasps=100, cache_dir=cache_dir)
    answers.put([item.content_hash for item in objects])


def test_two_processes_at_once_leave_whole_files(tmp_path):
    context = multiprocessing.get_context("fork")
    start, answers = context.Barrier(2), context.Queue()
    pair = [context.Process(target=_hashes, args=(tmp_path, start, answers)) for _ in range(2)]
    for process in pair:
        process.start()
    first, second = answers.get(timeout=60), answers.get(timeout=60)
    for process in pair:
        process.join(timeout=10)
    assert first == second and len(set(first)) == 3
    assert len(list(tmp_path.iterdir())) == 3  # no partial file is left


def test_prepare_builds_in_processes_what_this_process_would(tmp_path):
    pair = [
        ProceduralObjects("val", num_objects=2, num_grasps=100, cache_dir=tmp_path / place) for place in "ab"
    ]
    pair[0].prepare(workers=2)
    pair[1].prepare(progress=False)
    names = [sorted(file.name for file in (tmp_path / place).iterdir()) for place in "ab"]
    assert names[0] == names[1] and len(names[0]) == 2
    assert [item.content_hash for item in pair[0]] == [item.content_hash for item in pair[1]]


@pytest.mark.slow
def test_a_script_without_a_main_guard_still_gets_its_objects(tmp_path):
    script = tmp_path / "unguarded.py"
    script.write_text(
        "import sys\nfrom torchgrasp.objects import ProceduralObjects\n"
        "ProceduralObjects('val', num_objects=2, num_grasps=100, cache_dir=sys.argv[1]).prepare(workers=2)\n"
    )
    run = subprocess.run([sys.executable, str(script), str(tmp_path / "a")], capture_output=True, text=True)
    assert run.returncode == 0
    assert len(list((tmp_path / "a").glob("*.npz"))) == 2


def test_a_set_travels_without_its_memory(cache_dir):
    objects = ProceduralObjects("test", num_objects=10, cache_dir=cache_dir)
    first = objects[0]
    sent = pickle.dumps(objects)
    assert len(sent) < 5000
    assert pickle.loads(sent)[0].content_hash == first.content_hash


def test_an_unwritable_cache_is_told_and_survived(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("a file stands where the directory should be")
    objects = ProceduralObjects("train", num_objects=1, num_grasps=100, cache_dir=blocked / "objects")
    with pytest.warns(UserWarning, match="TORCHGRASP_CACHE"):
        assert len(objects[0].grasps) == 100


def test_cache_directory_follows_the_environment(monkeypatch):
    monkeypatch.setenv("TORCHGRASP_CACHE", os.sep + "somewhere")
    assert str(default_cache_dir()) == os.path.join(os.sep + "somewhere", "objects")
    monkeypatch.delenv("TORCHGRASP_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", os.sep + "user")
    assert default_cache_dir().parts[-3:] == ("user", "torchgrasp", "objects")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"split": "tset"}, "split='tset'"),
        ({"num_objects": 0}, "num_objects=0"),
        ({"num_grasps": 50}, "num_grasps=50"),
        ({"seed": -1}, "seed=-1"),
        ({"workers": 0}, "workers=0"),
        ({"families": ["teapot"]}, "'teapot'.*box"),
        ({"families": ["hammer"]}, "'hammer'.*test"),
        ({"families": []}, "at least one"),
        ({"families": ["box", "box"]}, "each once"),
    ],
)
def test_wrong_options_are_refused_at_construction(options, message):
    with pytest.raises(ConfigError, match=message):
        ProceduralObjects(**options)


def test_index_out_of_range():
    with pytest.raises(IndexError):
        ProceduralObjects("train", num_objects=2)[2]


def test_a_user_without_a_home_is_told_of_the_variable(monkeypatch):
    for name in ("TORCHGRASP_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000_000)  # as containers start: no entry of this number
    with pytest.raises(ConfigError, match=r"no home directory .*set TORCHGRASP_CACHE"):
        ProceduralObjects("train", num_objects=1)
    monkeypatch.setenv("TORCHGRASP_CACHE", "~/cache")
    with pytest.raises(ConfigError, match=r"^TORCHGRASP_CACHE='~/cache': no home directory is known"):
        ProceduralObjects("train", num_objects=1)
