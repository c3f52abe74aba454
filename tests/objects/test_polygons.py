import numpy as np
import pytest
import trimesh

from torchgrasp.errors import ObjectError
from torchgrasp.objects.mesh_files import read_triangles
from torchgrasp.objects.polygons import triangulate

# A U of 6 x 8 cm with a notch of 2 x 6 cm, counter-clockwise: 36 cm2.
U = np.array([(0, 0, 0), (6, 0, 0), (6, 8, 0), (4, 8, 0), (4, 2, 0), (2, 2, 0), (2, 8, 0), (0, 8, 0)], float)


def areas(vertices, faces):
    """Signed areas along z."""
    a, b, c = np.asarray(vertices)[np.asarray(faces)].transpose(1, 0, 2)
    return np.cross(b - a, c - a)[:, 2] / 2


@pytest.mark.parametrize("turn", range(8))
@pytest.mark.parametrize("order", [1, -1])
def test_a_concave_face_keeps_its_notch(turn, order):
    polygon = np.roll(np.arange(8), turn)[::order].tolist()
    signed = areas(U, list(triangulate(U, polygon)))
    assert len(signed) == 6
    assert (signed * order > 0).all() and np.abs(signed).sum() == pytest.approx(36)


def test_a_convex_face_is_a_fan():
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
    assert list(triangulate(square, [0, 1, 2, 3])) == [(0, 1, 2), (0, 2, 3)]


def test_a_star_of_many_corners_is_covered_once():
    angles = np.arange(400) * np.pi / 200
    radius = np.where(np.arange(400) % 2, 1.0, 2.0)
    star = np.stack((radius * np.cos(angles), radius * np.sin(angles), 0 * angles), 1)
    signed = areas(star, list(triangulate(star, range(400))))
    x, y, _ = star.T
    assert (signed > 0).all() and signed.sum() == pytest.approx(
        (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    )


BAR = np.concatenate((U, U + np.array((0, 0, 4)))) / 100
CAPS = [list(range(7, -1, -1)), list(range(8, 16))]
BAR_FACES = CAPS + [[i, (i + 1) % 8, 8 + (i + 1) % 8, 8 + i] for i in range(8)]


def write_bar(path):
    """The U as a bar of 4 cm, its caps one face each: 232 cm2 in all."""
    rows = [" ".join(f"{each:.4f}" for each in corner) for corner in BAR]
    if path.suffix == ".obj":
        faces = ["f " + " ".join(f"{corner + 1}" for corner in face) for face in BAR_FACES]
        text = [*(f"v {row}" for row in rows), *faces]
    else:
        faces = [" ".join(map(str, (len(face), *face))) for face in BAR_FACES]
        head = ["OFF", "16 10 0"]
        if path.suffix == ".ply":
            axes = [f"property float {axis}" for axis in "xyz"]
            head = ["ply", "format ascii 1.0", "element vertex 16", *axes, "element face 10"]
            head += ["property list uchar int vertex_indices", "end_header"]
        text = [*head, *rows, *faces]
    path.write_text("\n".join(text) + "\n")


@pytest.mark.parametrize("suffix", ["obj", "off", "ply"])
def test_files_of_concave_faces_have_the_right_surface(tmp_path, suffix):
    write_bar(tmp_path / f"bar.{suffix}")
    mesh = read_triangles(tmp_path / f"bar.{suffix}")
    assert mesh.area == pytest.approx(232e-4, rel=1e-6)
    assert mesh.is_watertight and mesh.volume == pytest.approx(36e-4 * 0.04, rel=1e-6)


def test_numbers_that_count_back_are_counted_from_where_they_stand(tmp_path):
    tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf -4 -2 -3\nf -4 -3 -1\nf -4 -1 -2\nf -3 -2 -1\n"
    (tmp_path / "pair.obj").write_text(tetrahedron + tetrahedron.replace("v 0 0 0", "v 9 9 9"))
    vertices = read_triangles(tmp_path / "pair.obj").vertices
    assert len(vertices) == 8 and (vertices == 9).any()
    mesh = read_triangles(tmp_path / "pair.obj")
    assert set(np.asarray(mesh.faces[:4]).ravel()) == {0, 1, 2, 3}
    assert set(np.asarray(mesh.faces[4:]).ravel()) == {4, 5, 6, 7}


@pytest.mark.parametrize("corner", ["0", "9", "-9"])
def test_corners_that_do_not_exist_are_told(tmp_path, corner):
    (tmp_path / "bad.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 {corner}\n")
    with pytest.raises(ObjectError, match=r"bad\.obj cannot be read as a mesh"):
        read_triangles(tmp_path / "bad.obj")


def test_files_of_triangles_and_plane_quads_are_left_to_the_reader(tmp_path):
    box = trimesh.creation.box((0.04, 0.05, 0.12))
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    text = "".join("v {} {} {}\n".format(*corner) for corner in box.vertices)
    (tmp_path / "box.obj").write_text(
        text + "".join("f {} {} {} {}\n".format(*(np.array(q) + 1)) for q in quads)
    )
    mesh, read = read_triangles(tmp_path / "box.obj"), trimesh.load_mesh(tmp_path / "box.obj", process=False)
    assert np.array_equal(mesh.vertices, read.vertices) and np.array_equal(mesh.faces, read.faces)
