import numpy as np
import pytest
import trimesh

from torchgrasp.objects.families import FAMILIES
from torchgrasp.objects.solids import box, cylinder, hull, join, mass_properties
from torchgrasp.objects.surface import RayTarget, depth_in_parts, sample_surface, surface_points


def test_mass_of_two_boxes_by_hand():
    # 8 cm3 at x = 0 and 1 cm3 at x = 2.7 cm: the centre lies at 2.7 / 9 cm.
    solid = join(box((0.02, 0.02, 0.02)), box((0.01, 0.01, 0.01)).moved((0.027, 0.0, 0.0)))
    volume, centre = mass_properties(solid.parts)
    assert volume == pytest.approx(9e-6)
    assert centre == pytest.approx((0.003, 0.0, 0.0), abs=1e-12)


def test_ray_meets_a_cylinder_where_it_stands():
    can = cylinder(0.03, 0.1)
    distance, face = RayTarget(can.vertices, can.faces).cast(
        np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]),
        np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    )
    assert distance[:2] == pytest.approx((0.95, 0.97), abs=1e-6)
    assert np.isinf(distance[2]) and face[2] == -1


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", [0, 1])
def test_each_closed_piece_has_outward_normals(family, seed):
    solid = FAMILIES[family](np.random.default_rng(seed))
    pieces = trimesh.Trimesh(solid.vertices, solid.faces).split(only_watertight=True)
    assert sum(len(piece.faces) for piece in pieces) == len(solid.faces)
    assert all(piece.is_winding_consistent and piece.volume > 0 for piece in pieces)


def test_parts_are_convex_small_and_solid(item):
    for part in item.parts:
        assert part.dtype == np.float32 and 4 <= len(part) <= 64
        assert len(hull(part.astype(np.float64))[0]) >= 4
        assert np.linalg.svd(part - part.mean(0), compute_uv=False)[-1] > 1e-3


def test_parts_cover_the_surface_and_nothing_else(item):
    rng = np.random.default_rng(0)
    vertices, faces = item.vertices.astype(np.float64), item.faces
    parts = [part.astype(np.float64) for part in item.parts]
    seen, _ = sample_surface(vertices, faces, 4000, rng)
    assert depth_in_parts(seen, parts).min() > -0.0015
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    for i in range(0, len(parts), max(1, len(parts) // 4)):
        felt, _ = sample_surface(*hull(parts[i]), 60, rng)
        others = parts[:i] + parts[i + 1 :]
        felt = felt[depth_in_parts(felt, others) < -2e-4] if others else felt
        if len(felt):
            assert trimesh.proximity.closest_point_naive(mesh, felt)[1].max() < 0.0015


def test_centre_of_mass_is_the_origin(item):
    volume, centre = mass_properties([part.astype(np.float64) for part in item.parts])
    assert np.abs(centre).max() < 1e-6
    assert volume == pytest.approx(item.volume, rel=1e-4)


@pytest.mark.parametrize("family", FAMILIES)
def test_sizes_fit_a_table_and_a_hand(family):
    for seed in range(20):
        solid = FAMILIES[family](np.random.default_rng(seed))
        sides = np.sort(np.ptp(solid.vertices, axis=0))
        assert 0.03 < sides[2] < 0.21
        assert sides[0] < 0.075 or family in ("bowl", "mug")


def test_surface_points_lie_on_the_surface_and_are_kept(one_of_each):
    box = one_of_each["box"]
    points = surface_points(box)
    half = np.abs(box.vertices).max(0)
    assert points.shape == (512, 3)
    assert np.abs(np.abs(points) - half).min(1).max() < 1e-6 and (np.abs(points) < half + 1e-6).all()
    assert surface_points(box) is points
    assert not np.array_equal(surface_points(one_of_each["mug"]), points)
