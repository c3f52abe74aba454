"""Meshes for the renderer."""

import numpy as np
import pytest

from torchgrasp.sim.visuals import box_visual, capsule_visual, mesh_visual


def test_every_triangle_is_there_from_both_sides():
    box = box_visual(np.array((0.1, 0.2, 0.3)))
    triangles = box.vertices[box.faces].astype(np.float64)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert len(triangles) == 24 and np.allclose(normals[:12], -normals[12:])
    shading = box.normals[box.faces].mean(axis=1)
    assert ((normals * shading).sum(-1) > 0).all()


def test_a_closed_mesh_may_do_without_the_inside():
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], dtype=np.float32)
    both = mesh_visual(corners, np.array([(0, 1, 2)]), repeats=1.0)
    one = mesh_visual(corners, np.array([(0, 1, 2)]), repeats=1.0, both_sides=False)
    assert len(both.faces) == 2 and len(one.faces) == 1 and len(one.vertices) == 3
    triangle = one.vertices[one.faces[0]]
    assert (
        np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])[2] > 0
        and (one.normals[:, 2] == 1).all()
    )


def test_a_box_is_shaded_flat_and_a_capsule_round():
    box = box_visual(np.array((0.1, 0.2, 0.3)))
    assert np.isin(np.abs(box.normals), (0.0, 1.0)).all() and len(box.vertices) == 2 * 24
    capsule = capsule_visual(0.06, 0.2)
    outside = capsule.vertices[: len(capsule.vertices) // 2]
    axis = np.clip(outside[:, 2], -0.1, 0.1)[:, None] * (0.0, 0.0, 1.0)
    radial = (outside - axis) / 0.06
    assert np.allclose(np.linalg.norm(radial, axis=-1), 1.0, atol=1e-4)
    assert ((radial * capsule.normals[: len(outside)]).sum(-1) > 0.98).all()


def test_flat_triangles_are_left_out():
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0)], dtype=np.float32)
    visual = mesh_visual(vertices, np.array([(0, 1, 2), (0, 1, 3)]), repeats=1.0)
    assert len(visual.faces) == 2 and np.isfinite(visual.normals).all()
    assert visual.uvs.max() == pytest.approx(1.0)
