import time

import numpy as np
import pytest
import trimesh

from torchgrasp.errors import ObjectError
from torchgrasp.objects.meshes import MAX_FACES, hand_scale, read_solid

BOX = (0.04, 0.05, 0.12)


def read(mesh, path, **options):
    mesh.export(path)
    return read_solid(path, scale=1.0, concavity=0.05, **options)


def test_an_open_mesh_is_closed_with_a_message(tmp_path):
    mesh = trimesh.creation.box(BOX)
    mesh.update_faces(np.arange(len(mesh.faces)) != 3)
    with pytest.warns(UserWarning, match=r"lid\.ply is open: its holes are closed"):
        solid = read(mesh, tmp_path / "lid.ply")
    assert len(solid.faces) == 12 and len(solid.parts) == 1


def test_an_inverted_mesh_is_turned_with_a_message(tmp_path):
    mesh = trimesh.creation.box(BOX)
    mesh.invert()
    with pytest.warns(UserWarning, match=r"box\.ply is inside out"):
        solid = read(mesh, tmp_path / "box.ply")
    assert trimesh.Trimesh(solid.vertices, solid.faces).volume == pytest.approx(np.prod(BOX))


def test_nan_vertices_are_left_out_where_no_face_needs_them_and_refused_elsewhere(tmp_path):
    corners = np.array(((0, 0, 0), (0.05, 0, 0), (0, 0.05, 0), (0, 0, 0.05), (np.nan, 0, 0)))
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    trimesh.Trimesh(corners, faces, process=False).export(tmp_path / "spare.off")
    trimesh.Trimesh(corners, [*faces, (0, 1, 4)], process=False).export(tmp_path / "broken.off")
    with pytest.warns(UserWarning, match="1 NaN vertices that no face uses"):
        assert len(read_solid(tmp_path / "spare.off", scale=1.0, concavity=0.05).vertices) == 4
    with pytest.raises(ObjectError, match=r"broken\.off has 1 vertices that are NaN"):
        read_solid(tmp_path / "broken.off", scale=1.0, concavity=0.05)


def test_a_mesh_of_far_too_many_faces_takes_seconds_and_keep_the_shape(tmp_path):
    mesh = trimesh.creation.icosphere(subdivisions=7, radius=0.03)
    mesh.export(tmp_path / "fine.stl")
    start = time.perf_counter()
    with pytest.warns(UserWarning, match=r"fine\.stl has 327680 triangles"):
        solid = read_solid(tmp_path / "fine.stl", scale=1.0, concavity=0.05)
    assert time.perf_counter() - start < 30
    assert MAX_FACES / 2 <= len(solid.faces) <= MAX_FACES
    radii = np.linalg.norm(solid.vertices, axis=1)
    assert np.abs(radii - 0.03).max() < 0.0003
    assert len(solid.parts) == 1


@pytest.mark.parametrize("direction", [(0, 0, 0), (1, 2, 3)])
def test_triangles_that_are_lines_are_none(tmp_path, direction):
    vertices = np.outer(np.linspace(0, 0.1, 12), direction)
    trimesh.Trimesh(vertices, np.arange(12).reshape(4, 3), process=False).export(tmp_path / "lines.off")
    with pytest.raises(ObjectError, match=r"lines\.off has 0 usable triangles"):
        read_solid(tmp_path / "lines.off", scale=1.0, concavity=0.05)


def test_pinholes_are_told(tmp_path):
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=0.05)
    mesh.vertices[mesh.faces[0]] = mesh.vertices[mesh.faces[0]].mean(0) + 1e-5 * np.eye(3)
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "scan.ply")
    with pytest.warns(UserWarning, match=r"scan\.ply has pinholes: they are closed") as told:
        solid = read_solid(tmp_path / "scan.ply", scale=1.0, concavity=0.05)
    assert not [each for each in told if "is open" in str(each.message)]
    assert trimesh.Trimesh(solid.vertices, solid.faces, process=False).is_watertight


@pytest.mark.parametrize(
    ("size", "factor"),
    [
        ((0.04, 0.05, 0.12), 1.0),  # as it is
        ((0.13, 0.2, 0.2), 0.5),  # narrowest side to 6.5 cm
        ((0.05, 0.1, 1.0), 0.25),  # longest to 25 cm
        ((0.01, 0.01, 0.03), 2.0),  # grows to 6 cm
        ((0.05, 0.05, 0.05), 1.2),
        ((50.0, 60.0, 120.0), 0.065 / 50),  # in whatever unit
    ],
)
def test_resizing_by_hand_computed_factors(size, factor):
    assert hand_scale(np.asarray(trimesh.creation.box(size).vertices)) == pytest.approx(factor)


def test_resizing_makes_a_crate_graspable_whatever_its_unit(tmp_path):
    solid = read(trimesh.creation.box((400, 500, 600)), tmp_path / "crate.stl", resize=True)
    assert np.ptp(solid.vertices, axis=0) == pytest.approx((0.065, 0.08125, 0.0975))
