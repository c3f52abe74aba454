import time

import numpy as np
import pytest
import trimesh

from torchgrasp.objects.decomposition import MAX_PARTS, convex_parts, merge_parts, split_bodies
from torchgrasp.objects.surface import depth_in_parts, sample_surface


def arrays(*meshes):
    mesh = trimesh.util.concatenate(meshes)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def box(size, place=(0.0, 0.0, 0.0)):
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(place))


def volumes(parts):
    return [trimesh.convex.convex_hull(part).volume for part in parts]


def test_bodies_that_are_convex_are_their_own_parts():
    pair = box((0.03, 0.04, 0.1)), box((0.02, 0.04, 0.1), (0.03, 0, 0))
    start = time.perf_counter()
    parts = convex_parts(*arrays(*pair), concavity=0.05)
    assert time.perf_counter() - start < 1
    assert volumes(parts) == pytest.approx([0.03 * 0.04 * 0.1, 0.02 * 0.04 * 0.1])
    assert depth_in_parts(np.array([[0.0175, 0, 0]]), parts)[0] == pytest.approx(-0.0025)


def test_one_body_is_left_as_it_is():
    vertices, faces = arrays(trimesh.creation.annulus(0.02, 0.04, 0.03, sections=12))
    ((kept, same),) = split_bodies(vertices, faces)
    assert kept is vertices and same is faces


def test_bodies_come_largest_first_with_their_cavities_and_what_is_open_together():
    shell, cavity = box((0.1, 0.1, 0.1)), box((0.06, 0.06, 0.06))
    cavity.invert()
    apart = box((0.02, 0.02, 0.02), (0.2, 0, 0))
    leaves = [trimesh.Trimesh(np.eye(3) * 0.03 + (0, 0, z), [(0, 1, 2)], process=False) for z in (0.2, 0.22)]
    bodies = split_bodies(*arrays(apart, *leaves, cavity, shell))
    assert [len(faces) for _, faces in bodies] == [24, 2, 12]
    around, loose, small = (trimesh.Trimesh(*body, process=False) for body in bodies)
    assert around.volume == pytest.approx(0.1**3 - 0.06**3)
    assert small.volume == pytest.approx(0.02**3)
    assert len(loose.vertices) == 6


def shards(count, seed=0):
    """Small balls that together are a bottle."""
    bottle = trimesh.creation.cylinder(0.03, 0.16)
    points, _ = trimesh.sample.sample_surface(bottle, count, seed=seed)
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(subdivisions=1)
    return arrays(
        *(trimesh.Trimesh(ball.vertices * rng.uniform(0.004, 0.007) + p, ball.faces) for p in points)
    )


def test_shards_become_a_bounded_number_of_parts_that_cover_them():
    vertices, faces = shards(240)
    start = time.perf_counter()
    parts = convex_parts(vertices, faces, concavity=0.05)
    assert time.perf_counter() - start < 10
    assert len(parts) == MAX_PARTS and all(len(part) <= 64 for part in parts)
    seen, _ = sample_surface(vertices, faces, 2000, np.random.default_rng(0))
    assert depth_in_parts(seen, parts).min() > -0.002
    assert depth_in_parts(np.zeros((1, 3)), parts)[0] < 0  # the bottle stays hollow


def test_the_closest_parts_are_merged_first():
    row = [np.asarray(box((0.01, 0.01, 0.01), (x, 0, 0)).vertices) for x in (0.0, 0.01, 0.05, 0.08)]
    parts = merge_parts(row, 3)
    assert sorted(volumes(parts)) == pytest.approx([1e-6, 1e-6, 2e-6])
    assert len(merge_parts(row, 4)) == 4
    assert volumes(merge_parts(row, 1)) == pytest.approx([9e-6])


def test_a_small_body_is_split_no_finer_than_the_whole_needs():
    """A cup of a fiftieth of the object's size stands for itself as one part."""
    cup = trimesh.creation.annulus(0.001, 0.002, 0.002, sections=16)
    cup.apply_translation((0.2, 0, 0))
    assert len(convex_parts(*arrays(box((0.1, 0.05, 0.05)), cup), concavity=0.05)) == 2


def test_a_thin_wall_gets_no_thicker():
    """A cup of 2 mm, of 25,600 triangles."""
    profile = [(0, 0), (0.04, 0), (0.04, 0.09), (0.038, 0.09), (0.038, 0.002), (0, 0.002)]
    cup = trimesh.creation.revolve(profile, sections=50).subdivide().subdivide().subdivide()
    parts = convex_parts(*arrays(cup), concavity=0.05)
    assert sum(volumes(parts)) == pytest.approx(cup.volume, rel=0.3)
    assert depth_in_parts(np.array([[0, 0, 0.05]]), parts)[0] < -0.03
    seen, _ = sample_surface(*arrays(cup), 2000, np.random.default_rng(0))
    depth = depth_in_parts(seen, parts)
    assert depth.min() > -0.001 and np.median(depth) < 0.001


def test_a_body_that_is_inside_out_gets_the_same_parts():
    vertices, faces = arrays(trimesh.creation.annulus(0.02, 0.04, 0.03, sections=12))
    parts = convex_parts(vertices, faces, concavity=0.2)
    turned = convex_parts(vertices, faces[:, ::-1], concavity=0.2)
    assert len(turned) == len(parts)
    assert sum(volumes(turned)) == pytest.approx(sum(volumes(parts)), rel=0.05)
    assert depth_in_parts(np.zeros((1, 3)), turned)[0] < -0.01
