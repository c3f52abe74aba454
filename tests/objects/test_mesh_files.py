import base64
import json
import os
import struct
import time

import numpy as np
import pytest
import trimesh

from torchgrasp.errors import ObjectError
from torchgrasp.objects import FolderObjects
from torchgrasp.objects.mesh_files import MAX_BYTES, read_triangles
from torchgrasp.objects.meshes import read_solid

BOX = trimesh.creation.box((0.06, 0.04, 0.10))
CORNERS, TRIANGLES = np.asarray(BOX.vertices), np.asarray(BOX.faces)
DRACO = base64.b64decode(
    "RFJBQ08CAgEBAAAACAwACwAAA19LFQEBEAH/AAABAAkDAAACAAEBAA8HAQgrATgDAAaFMzMAAAAAADJzAAAAxMwAAM0MAAAAAIDMDACA"
    "MzMAAADQzDEzAAAAAAAA/z8AAAAAAAAAAAAAAAAAAM3MzD0O"
)


def write_glb(path, header, binary):
    text = json.dumps(
        {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], **header}
    ).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)


def glb_header(**changes):
    """A box of quantised positions, normalised 16-bit numbers with a stride of 8 bytes."""
    header = {
        "nodes": [{"mesh": 0, "scale": [0.03, 0.02, 0.05]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5122, "normalized": True, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 64, "byteStride": 8},
            {"buffer": 0, "byteOffset": 64, "byteLength": 72},
        ],
        "buffers": [{"byteLength": 136}],
    }
    return header | changes


def quantised_box():
    whole = np.zeros((8, 4), "<i2")
    whole[:, :3] = np.round(CORNERS / (0.03, 0.02, 0.05) * 32767)
    return whole.tobytes() + TRIANGLES.astype("<u2").tobytes()


def ply(vertices=CORNERS, faces=TRIANGLES, *, counts=None, comment=""):
    num_vertices, num_faces = counts or (len(vertices), len(faces))
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat ascii 1.0\n{comment}element vertex {num_vertices}\n{axes}element face {num_faces}\n"
    rows = ["{} {} {}".format(*row) for row in vertices] + ["3 {} {} {}".format(*row) for row in faces]
    return head + "property list uchar int vertex_indices\nend_header\n" + "\n".join(rows) + "\n"


def off(vertices=CORNERS, faces=TRIANGLES, *, counts=None):
    num_vertices, num_faces = counts or (len(vertices), len(faces))
    rows = ["{} {} {}".format(*row) for row in vertices] + ["3 {} {} {}".format(*row) for row in faces]
    return f"OFF\n{num_vertices} {num_faces} 0\n" + "\n".join(rows) + "\n"


def stl(*, announced=12, behind=b""):
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *CORNERS[face].ravel(), 0) for face in TRIANGLES)
    return b"part".ljust(80) + struct.pack("<I", announced) + rows + behind


def test_readers_say_nothing_of_a_picture_that_is_absent(tmp_path, capfd):
    (tmp_path / "cup.ply").write_text(ply(comment="comment TextureFile picture.png\n"))
    assert len(read_triangles(tmp_path / "cup.ply").faces) == 12
    assert capfd.readouterr() == ("", "")


def test_bytes_behind_the_triangles_of_an_stl_file_are_left_out(tmp_path):
    (tmp_path / "box.stl").write_bytes(stl(behind=bytes(7)))
    assert np.ptp(read_triangles(tmp_path / "box.stl").vertices, axis=0) == pytest.approx((0.06, 0.04, 0.10))


def test_normalised_positions_are_read_as_fractions(tmp_path):
    write_glb(tmp_path / "box.glb", glb_header(), quantised_box())
    mesh = read_triangles(tmp_path / "box.glb")
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx((0.06, 0.04, 0.10), rel=1e-4)
    assert mesh.volume == pytest.approx(2.4e-4, rel=1e-3)


def write_bad_files(folder):
    """Damaged and hostile files: name to what is told of it."""
    far = np.where(TRIANGLES == 7, 100, TRIANGLES)
    texts = {
        "cloud.ply": ply(faces=()).replace("element face 0\nproperty list uchar int vertex_indices\n", ""),
        "points.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n",
        "pointer.obj": f"version https://git-lfs.github.com/spec/v1\noid sha256:{'4d' * 32}\nsize 183620\n",
        "far.ply": ply(faces=far),
        "far.off": off(faces=far),
        "negative.ply": ply(faces=np.where(TRIANGLES == 7, -1, TRIANGLES)),
        "less.ply": ply(counts=(-8, 12)),
        "less.off": off(counts=(-8, 12)),
        "absurd.ply": ply(counts=(8, 10**15)),
        "absurd.off": off(counts=(10**15, 12)),
        "cut.obj": "v 0 0 0\nv 1 0 0\nf 1 2 3\nf 1 2 4",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "cut.stl").write_bytes(stl()[:-70])
    (folder / "absurd.stl").write_bytes(stl(announced=2**32 - 1))
    accessors = glb_header()["accessors"]
    zeros = [{"componentType": 5126, "count": 10**15, "type": "VEC3"}, accessors[1]]
    write_glb(folder / "absurd.glb", glb_header(accessors=zeros), quantised_box())
    far_away = [accessors[0], {**accessors[1], "count": 2**40}]
    write_glb(folder / "long.glb", glb_header(accessors=far_away), quantised_box())
    outside = [{"byteLength": 136, "uri": "../secrets.bin"}]
    write_glb(folder / "outside.glb", glb_header(buffers=outside), b"")
    compressed = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    draco = glb_header(
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "extensions": compressed}]}],
        accessors=[
            {"componentType": 5126, "count": 8, "type": "VEC3"},
            {"componentType": 5125, "count": 36, "type": "SCALAR"},
        ],
        bufferViews=[{"buffer": 0, "byteOffset": 0, "byteLength": len(DRACO)}],
    )
    write_glb(folder / "draco.glb", draco, DRACO + bytes(-len(DRACO) % 4))
    os.mkfifo(folder / "pipe.obj")
    (folder / "endless.stl").symlink_to("/dev/zero")
    with open(folder / "huge.stl", "wb") as file:
        file.truncate(MAX_BYTES + 1)
    return {
        "cloud.ply": "point cloud",
        "points.obj": "point cloud",
        "pointer.obj": "Git LFS pointer.*git lfs pull",
        "far.ply": "vertices 0 to 100 where 8 exist",
        "far.off": "cannot be read as a mesh",
        "negative.ply": "vertices -1 to 6 where 8 exist",
        "less.ply": "announces -8 of vertex",
        "less.off": "-8 vertices and 12 faces in 20 lines",
        "absurd.ply": "announces 1000000000000000 of face",
        "absurd.off": "1000000000000000 vertices and 12 faces in 20 lines",
        "cut.obj": "cannot be read as a mesh",
        "cut.stl": "announces 12 triangles and holds 10",
        "absurd.stl": "announces 4294967295 triangles and holds 12",
        "absurd.glb": "announces 1000000000000000 elements",
        "long.glb": "announces 1099511627776 elements",
        "outside.glb": "another file, '../secrets.bin'",
        "draco.glb": "compressed by Draco",
        "pipe.obj": "no file but a folder, pipe or device",
        "endless.stl": "no file but a folder, pipe or device",
        "huge.stl": "500 MB are read",
    }


def test_what_is_wrong_with_a_file_is_told_in_one_line_and_at_once(tmp_path, capfd):
    start = time.perf_counter()
    for name, told in write_bad_files(tmp_path).items():
        with pytest.raises(ObjectError, match=rf"{name} .*{told}") as caught:
            read_triangles(tmp_path / name)
        assert "\n" not in str(caught.value)
    assert time.perf_counter() - start < 5
    assert capfd.readouterr() == ("", "")


def test_bad_files_are_skipped_and_remembered(tmp_path):
    (tmp_path / "meshes").mkdir()
    bad = write_bad_files(tmp_path / "meshes")
    (tmp_path / "meshes" / "pipe.obj").unlink()  # whether it is listed is for the folder to say
    (tmp_path / "meshes" / "endless.stl").unlink()
    BOX.export(tmp_path / "meshes" / "box.stl")
    for _ in range(2):
        with pytest.warns(UserWarning, match="Skipped") as caught:
            objects = FolderObjects(
                tmp_path / "meshes", on_error="skip", num_grasps=100, cache_dir=tmp_path / "cache"
            )
        assert objects.names == ("box",)
        assert sum("Skipped" in str(each.message) for each in caught) == len(bad) - 2


def test_an_unreadable_file_fails_when_it_is_asked_for_and_not_before(tmp_path):
    (tmp_path / "meshes").mkdir()
    BOX.export(tmp_path / "meshes" / "box.stl")
    objects = FolderObjects(tmp_path / "meshes", num_grasps=100, cache_dir=tmp_path / "cache")
    (tmp_path / "meshes" / "box.stl").unlink()
    assert objects.missing() == [0]
    with pytest.raises(ObjectError, match=r"box\.stl cannot be read"):
        objects[0]
    assert objects.missing() == [] and "restore it" in (objects.refusal(0) or "")
    BOX.export(tmp_path / "meshes" / "box.stl")
    assert len(objects[0].grasps) == 100


@pytest.mark.parametrize(
    ("metres", "advice"),
    [
        (10.0, r"centimetres, try scale=0\.01"),
        (200.0, r"millimetres, try scale=0\.001"),
        (40.0, r"centimetres, try scale=0\.01, or in millimetres, try scale=0\.001"),
        (1e5, "give the scale= that yields metres"),
    ],
)
def test_a_length_tells_the_unit_where_one_is_likely(tmp_path, metres, advice):
    trimesh.creation.box((metres, metres / 2, metres / 2)).export(tmp_path / "box.stl")
    with pytest.raises(ObjectError, match=rf"m long with scale=1: .*{advice}"):
        read_solid(tmp_path / "box.stl", scale=1.0, concavity=1.0)
