import numpy as np
import pytest
import trimesh

from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects import FolderObjects
from torchgrasp.objects.decomposition import convex_parts, reduce_hull
from torchgrasp.objects.surface import depth_in_parts


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "kitchen"
    (path / "sub").mkdir(parents=True)
    trimesh.creation.box((0.04, 0.05, 0.12)).export(path / "block.obj")
    trimesh.creation.icosphere(subdivisions=3, radius=0.03).export(path / "sub" / "ball.ply")
    (path / "readme.txt").write_text("not a mesh")
    return path


@pytest.fixture
def open_folder(tmp_path):
    return lambda path, **options: FolderObjects(
        path, cache_dir=tmp_path / "cache", num_grasps=100, **options
    )


def test_meshes_become_graspable_objects(folder, open_folder):
    objects = open_folder(folder, licence="CC BY 4.0")
    assert objects.names == ("block", "sub/ball")
    block, ball = objects
    assert block.family == "kitchen" and block.licence == "CC BY 4.0"
    assert block.volume == pytest.approx(0.04 * 0.05 * 0.12, rel=1e-5)
    assert len(block.parts) == 1 and len(block.grasps) == 100
    assert len(ball.parts[0]) <= 64 and len(ball.grasps) == 100
    assert ball.size == pytest.approx([0.06] * 3, abs=1e-3)
    again = open_folder(folder, licence="CC BY 4.0")
    assert [item.content_hash for item in again] == [block.content_hash, ball.content_hash]


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "off"])
def test_every_format_gives_the_same_box(tmp_path, open_folder, suffix):
    (tmp_path / "one").mkdir()
    trimesh.creation.box((0.04, 0.05, 0.12)).export(tmp_path / "one" / f"block.{suffix}")
    (block,) = open_folder(tmp_path / "one")
    assert block.vertices.shape == (8, 3) and block.volume == pytest.approx(2.4e-4, rel=1e-4)


def test_scale_and_the_millimetre_message(folder, open_folder):
    trimesh.creation.box((40, 50, 120)).export(folder / "drawn_in_mm.stl")
    with pytest.raises(ObjectError, match=r"drawn_in_mm\.stl is 120 m long.*scale=0\.001"):
        open_folder(folder, include=["drawn_in_mm"])[0]
    (block,) = open_folder(folder, include=["drawn_in_mm"], scale=0.001)
    assert block.size == pytest.approx([0.04, 0.05, 0.12])


def test_a_mesh_turned_inside_out_is_turned_back(folder, open_folder):
    mesh = trimesh.creation.box((0.03, 0.05, 0.08))
    mesh.invert()
    mesh.export(folder / "inverted.off")
    assert len(open_folder(folder, include=["inverted"])[0].grasps) == 100


def _write_bad_files(folder):
    (folder / "garbage.stl").write_bytes(b"\x00\x01 this is no mesh")
    (folder / "empty.obj").write_text("")
    (folder / "nan.obj").write_text(
        "v 0 0 0\nv nan 1 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
    )
    trimesh.Trimesh([(0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0), (0, 0.1, 0)], [(0, 1, 2), (0, 2, 3)]).export(
        folder / "sheet.ply"
    )
    flat = np.array(((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0.03, 0.03, 0)))
    trimesh.Trimesh(flat, [(0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)]).export(folder / "flat.ply")
    trimesh.creation.box((0.002, 0.002, 0.001)).export(folder / "dust.ply")
    trimesh.creation.box((0.2, 0.2, 0.2)).export(folder / "crate.ply")
    return {
        "garbage": "read|triangles",
        "empty": "read|triangles",
        "nan": "NaN",
        "sheet": "triangles",
        "flat": "flat",
        "dust": "scale=",
        "crate": "0 grasps.*20.0 x 20.0 x 20.0 cm",
    }


def test_each_bad_mesh_is_refused_by_name(folder, open_folder):
    for name, message in _write_bad_files(folder).items():
        with pytest.raises(ObjectError, match=rf"(?s){name}\.\w+ .*({message})"):
            open_folder(folder, include=[name])[0]


def test_bad_meshes_can_be_skipped(folder, open_folder):
    bad = _write_bad_files(folder)
    for _ in range(2):  # the second time from what the cache remembers
        with pytest.warns(UserWarning, match="Skipped") as caught:
            objects = open_folder(folder, on_error="skip")
        assert objects.names == ("block", "sub/ball")
        assert sum("Skipped" in str(warning.message) for warning in caught) == len(bad)
    with pytest.warns(UserWarning), pytest.raises(ObjectError, match="No mesh"):
        open_folder(folder, include=["dust", "crate"], on_error="skip")


def test_folders_that_are_missing_or_bare(tmp_path, open_folder):
    with pytest.raises(ObjectError, match=r"nowhere is not a directory"):
        open_folder(tmp_path / "nowhere")
    (tmp_path / "bare").mkdir()
    with pytest.raises(ObjectError, match=r"bare holds no mesh file.*\.obj"):
        open_folder(tmp_path / "bare")


def test_splits_divide_the_folder(tmp_path, open_folder):
    for i in range(40):
        (tmp_path / f"thing{i}.off").write_text("")
    names = [open_folder(tmp_path, split=split).names for split in ("train", "val", "test")]
    assert sorted(sum(names, ())) == sorted(open_folder(tmp_path).names)
    assert len(names[0]) > 20


def test_names_keep_their_suffix_where_they_must(folder, open_folder):
    trimesh.creation.box((0.04, 0.05, 0.12)).export(folder / "block.stl")
    assert open_folder(folder).names == ("block.obj", "block.stl", "sub/ball")


def test_wrong_options(folder, open_folder):
    for options in ({"scale": 0.0}, {"concavity": 2.0}, {"split": "all"}, {"on_error": "ignore"}):
        with pytest.raises(ConfigError, match=next(iter(options))):
            open_folder(folder, **options)
    with pytest.raises(ObjectError, match=r"'spoon'.*block"):
        open_folder(folder, include=["spoon"])


def test_a_hollow_mesh_is_split_and_stays_hollow():
    tray = trimesh.creation.annulus(0.02, 0.04, 0.03, sections=12)
    vertices, faces = np.asarray(tray.vertices), np.asarray(tray.faces)
    parts = convex_parts(vertices, faces, concavity=0.2)
    assert len(parts) > 2 and all(len(part) <= 64 for part in parts)
    assert depth_in_parts(np.zeros((1, 3)), parts)[0] < 0


def test_reduced_hull_stays_near_and_drops_what_is_flat():
    ball = np.asarray(trimesh.creation.icosphere(subdivisions=4, radius=0.04).vertices)
    kept = reduce_hull(ball)
    assert kept is not None and len(kept) <= 64
    assert depth_in_parts(ball, [kept]).min() > -0.0025
    assert reduce_hull(ball * (1, 1, 0)) is None
