import pytest

from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects import RandomUrdfObjects, YcbObjects, packaged
from torchgrasp.objects.build import BUILD_VERSION
from torchgrasp.objects.ycb import TEST, TRAIN

SETS = {"ycb": YcbObjects, "random_urdfs": RandomUrdfObjects}


@pytest.mark.parametrize(
    ("kind", "total"), [("ycb", 78), pytest.param("random_urdfs", 1000, marks=pytest.mark.pybullet)]
)
def test_the_index_knows_every_object_and_sets_leave_out_the_unusable(kind, total):
    everything = SETS[kind](usable_only=False)
    index = packaged.read_index(kind)
    assert len(everything) == total and sorted(index) == sorted(everything.names)
    usable = SETS[kind]()
    assert set(usable.names) == {name for name, reason in index.items() if not reason}
    assert 0.8 * total < len(usable) < total


def test_the_index_is_of_this_build():
    for kind in SETS:
        text = (packaged.INDEX_DIR / f"{kind}.json").read_text()
        assert f'"build_version": {BUILD_VERSION},' in text, "renew it: python -m torchgrasp objects ..."


def test_ycb_has_the_papers_nine_and_ten():
    assert YcbObjects("test").names == TEST
    assert YcbObjects("train", usable_only=False).names == TRAIN and len(TRAIN) == 10
    others = YcbObjects("others").names
    assert not set(others) & set(TRAIN) and len(others) > 50
    assert YcbObjects("others", num_objects=3).names == others[:3]


@pytest.mark.pybullet
def test_random_urdfs_are_split_by_number():
    bounds = {"train": (0, 799), "val": (800, 899), "test": (900, 999)}
    for split, (low, high) in bounds.items():
        names = RandomUrdfObjects(split, usable_only=False).names
        assert (names[0], names[-1]) == (f"random-{low:03d}", f"random-{high:03d}")
        assert len(names) == high - low + 1


def test_a_scan_becomes_an_object(cache_dir):
    objects = YcbObjects(num_grasps=100, cache_dir=cache_dir)
    pudding = objects[objects.names.index("008_pudding_box")]
    assert pudding.licence == objects.licence(0) == "CC BY 4.0"
    assert pudding.size.min() == pytest.approx(0.039, abs=2e-3)
    assert len(pudding.grasps) == 100 and len(pudding.parts) == 1


@pytest.mark.pybullet
def test_a_random_shape_keeps_its_parts(cache_dir):
    objects = RandomUrdfObjects("train", num_objects=1, num_grasps=100, cache_dir=cache_dir)
    (item,) = objects
    assert item.name == "random-000" and item.licence == "zlib"
    assert len(item.parts) == 5 and len(item.grasps) == 100
    assert item.size == pytest.approx((0.0904, 0.1202, 0.0316), abs=1e-3)


@pytest.mark.pybullet
def test_the_shape_with_nan_vertices_is_refused_by_name(cache_dir):
    objects = RandomUrdfObjects(usable_only=False, cache_dir=cache_dir)
    for _ in range(2):  # the second time from what the cache remembers
        with pytest.raises(ObjectError, match=r"168\.obj has 35 vertices that are NaN"):
            objects[168]
    assert "NaN" in (objects.refusal(168) or "")
    assert "random-168" not in RandomUrdfObjects().names


@pytest.mark.parametrize(("kind", "extra"), [("ycb", "ycb"), ("random_urdfs", "random-urdfs")])
def test_a_missing_package_is_named_by_its_extra(monkeypatch, kind, extra):
    monkeypatch.setattr(packaged.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=rf'pip install "torchgrasp\[{extra}\]"'):
        SETS[kind]()


@pytest.mark.parametrize("options", [{"split": "tset"}, {"num_objects": 0}, {"num_grasps": 10}])
@pytest.mark.parametrize("kind", ["ycb", pytest.param("random_urdfs", marks=pytest.mark.pybullet)])
def test_wrong_options_are_refused(kind, options):
    with pytest.raises(ConfigError, match=f"{next(iter(options))}="):
        SETS[kind](**options)


@pytest.mark.parametrize(
    "content",
    [b"\xff\xfe", b"{", b"[]", b'{"objects": []}', b'{"objects": {"a": 1}}', b"[" * 100_000, b"{}"],
)
def test_a_damaged_index_is_named(monkeypatch, tmp_path, content):
    (tmp_path / "ycb.json").write_bytes(content)
    monkeypatch.setattr(packaged, "INDEX_DIR", tmp_path)
    with pytest.raises(ObjectError, match=r"ycb\.json cannot be used .*install torchgrasp again"):
        packaged.read_index.__wrapped__("ycb")
