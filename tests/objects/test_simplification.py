import numpy as np
import pytest
import trimesh

from torchgrasp.objects.simplification import (
    close_pinholes,
    edges_at_holes,
    merge_cells,
    simplify,
    simplify_closed,
)


def arrays(mesh):
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def cup(wall=0.001):
    """8 cm wide, of 25,600 triangles."""
    outer, inner = 0.04, 0.04 - wall
    profile = [(0, 0), (outer, 0), (outer, 0.09), (inner, 0.09), (inner, wall), (0, wall)]
    mesh = trimesh.creation.revolve(profile, sections=50)
    return mesh.subdivide().subdivide().subdivide()


def ball():
    return trimesh.creation.icosphere(subdivisions=5, radius=0.05)


def test_a_mesh_of_few_triangles_is_left_as_it_is():
    vertices, faces = arrays(ball())
    kept, same = simplify(vertices, faces, max_faces=len(faces))
    assert kept is vertices and same is faces


def test_a_thin_wall_stays_closed_and_keeps_its_thickness():
    mesh = cup()
    kept, simple = simplify(*arrays(mesh), max_faces=4000)
    assert len(simple) <= 4000
    small = trimesh.Trimesh(kept, simple)
    assert small.is_watertight
    assert small.volume == pytest.approx(mesh.volume, rel=0.05)
    assert len(edges_at_holes(simple, len(kept))) == 0


def test_what_is_open_is_merged_on_a_grid():
    vertices, faces = arrays(ball())
    half = faces[vertices[faces].mean(1)[:, 2] < 0]
    assert simplify_closed(vertices, half, max_faces=4000) is None
    kept, simple = simplify(vertices, half, max_faces=4000)
    same, alike = merge_cells(vertices, half, max_faces=4000)
    assert np.array_equal(kept, same) and np.array_equal(simple, alike)
    assert 1000 < len(simple) <= 4000
    assert trimesh.Trimesh(kept, simple).area == pytest.approx(2 * np.pi * 0.05**2, rel=0.02)


def test_no_vertex_moves_farther_than_a_cells_diagonal():
    vertices, faces = arrays(trimesh.creation.icosphere(subdivisions=5, radius=0.03))
    kept, simple = merge_cells(vertices, faces, max_faces=3000)
    assert len(simple) <= 3000
    distance = np.linalg.norm(kept[:, None] - vertices[None, ::7], axis=2).min(0)
    assert distance.max() < 0.06 * np.sqrt(3) * 0.05


def test_a_closed_surface_that_so_few_triangles_cannot_show_is_not_emptied():
    links = [trimesh.creation.torus(0.012, 0.003) for _ in range(12)]
    for place, link in enumerate(links):
        link.apply_translation((0.02 * place, 0, 0))
    vertices, faces = arrays(trimesh.util.concatenate(links))
    assert simplify_closed(vertices, faces, max_faces=20) is None
    kept, simple = simplify(vertices, faces, max_faces=20)
    assert 4 <= len(simple) <= 20
    kept, simple = simplify(vertices, faces, max_faces=2000)
    assert 1000 <= len(simple) <= 2000
    assert np.ptp(kept, axis=0) == pytest.approx(np.ptp(vertices, axis=0), rel=0.1)


def fine_ball():
    """17 cm from corner to corner of its box, edges of 0.5 mm."""
    return arrays(trimesh.creation.icosphere(subdivisions=7, radius=0.05))


def test_pinholes_are_closed_and_larger_holes_are_left():
    vertices, faces = fine_ball()
    pierced = np.delete(faces, slice(1000, None, 2000), axis=0)
    assert len(edges_at_holes(pierced, len(vertices))) > 400
    closed = trimesh.Trimesh(*close_pinholes(vertices, pierced), process=False)
    assert closed.is_watertight and closed.is_winding_consistent
    assert closed.volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=1e-3)
    bowl = faces[vertices[faces].mean(1)[:, 2] < 0.045]
    assert len(close_pinholes(vertices, bowl)[1]) == len(bowl)
    coarse, wide = arrays(ball())  # edges of 2 mm
    assert len(close_pinholes(coarse, wide[1:])[1]) == len(wide) - 1


def test_a_flat_triangle_that_is_gone_leaves_no_hole():
    """Scans lose triangles whose corners lie on a line: the edges of its neighbours then do not meet."""
    vertices, faces = fine_ball()
    a, b, c = faces[1000]
    vertices = vertices.copy()
    vertices[c] = (vertices[a] + vertices[b]) / 2
    mesh = trimesh.Trimesh(vertices, np.delete(faces, 1000, axis=0), process=False)
    assert not mesh.is_watertight
    closed = trimesh.Trimesh(*close_pinholes(*arrays(mesh)), process=False)
    assert closed.is_watertight and closed.is_winding_consistent
    assert len(closed.faces) == len(mesh.faces) - 3


def test_loose_triangles_are_no_holes():
    """A soup as fine as a scan's, each corner a little off, and nothing that belongs together."""
    vertices, faces = fine_ball()
    corners = vertices[faces].reshape(-1, 3) + np.random.default_rng(0).normal(
        scale=1e-6, size=(3 * len(faces), 3)
    )
    soup = np.arange(len(corners)).reshape(-1, 3)
    assert len(close_pinholes(corners, soup)[1]) == len(faces)


def test_no_step_goes_far_below_the_number_that_is_allowed():
    vertices, faces = fine_ball()
    rough = vertices + np.random.default_rng(0).normal(scale=2e-5, size=vertices.shape)
    closed = simplify_closed(rough, faces, max_faces=50_000)
    assert closed is not None and 25_000 <= len(closed[1]) <= 50_000
