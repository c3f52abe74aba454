"""Spheres, distance fields and the cost of being close."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.planning.scenes import OBJECTS, resting
from torchgrasp.planning.clearance import Clearance
from torchgrasp.planning.distance import distance_field
from torchgrasp.planning.spheres import arm_spheres, column_spheres, self_pairs
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.panda_tables import ARM_SHAPES, hand_boxes

READY = kin.READY_POSTURE


@pytest.fixture(scope="module")
def box():
    mesh = trimesh.creation.box((0.10, 0.16, 0.24))
    vertices = mesh.vertices.astype(np.float32)
    faces = mesh.faces.astype(np.int32)
    return replace(OBJECTS[0], vertices=vertices, faces=faces, parts=(vertices,), content_hash="a box")


def postures(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(kin.JOINT_LOWER, kin.JOINT_UPPER, (count, 7))


def box_distance(points: np.ndarray) -> np.ndarray:
    out = np.abs(points) - np.array((0.05, 0.08, 0.12))
    return np.linalg.norm(np.maximum(out, 0), axis=-1) + np.minimum(out.max(axis=-1), 0)


def test_a_field_is_the_signed_distance_to_a_box(box):
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (2000, 3))
    distance, slope = distance_field(box).sample(points)
    near = box_distance(points) < 0.08
    error = np.abs(distance - box_distance(points))[near]
    assert np.median(error) < 3e-3 and error.max() < 0.012
    away = box_distance(points + 1e-4 * slope) - box_distance(points)
    assert np.mean(away > 0.5e-4) > 0.9


def test_far_points_have_far_distances(box):
    far = np.array([[1.0, 0.0, 0.0], [0.0, -2.0, 0.0]])
    distance, _ = distance_field(box).sample(far)
    assert distance == pytest.approx(box_distance(far), abs=0.02)


def test_spheres_cover_the_arm():
    spheres = arm_spheres()
    for number in range(2, 8):
        mine = spheres.link == number - 1
        for shape in ARM_SHAPES[number]:
            mesh = trimesh.creation.capsule(height=shape.size[1], radius=shape.size[0])
            points = mesh.vertices @ shape.rotation.T + shape.position
            gap = np.linalg.norm(points[:, None] - spheres.centre[mine], axis=-1) - spheres.radius[mine]
            assert gap.min(axis=1).max() < 0.012, number


def test_spheres_cover_the_open_hand_and_leave_the_gap_between_the_pads_open():
    spheres = arm_spheres()
    hand = spheres.link == 7
    for pose, size in hand_boxes():
        corners = (
            np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T * size @ pose[:3, :3].T + pose[:3, 3]
        )
        gap = np.linalg.norm(corners[:, None] - spheres.centre[hand], axis=-1) - spheres.radius[hand]
        assert gap.min(axis=1).max() < 0.022
    between = np.array([[0.0, y, 0.1034] for y in np.linspace(-0.038, 0.038, 9)])
    gap = np.linalg.norm(between[:, None] - spheres.centre[hand], axis=-1) - spheres.radius[hand]
    assert gap.min() > 0.0


def test_the_base_stands_still_and_only_links_that_may_meet_are_paired():
    centres, radii = column_spheres()
    assert len(centres) == len(radii) and centres[:, 2].max() < 0.333
    spheres = arm_spheres()
    first, second = self_pairs()
    links = {(int(a), int(b)) for a, b in zip(spheres.link[first] + 1, spheres.link[second] + 1, strict=True)}
    assert (2, 5) in links and (2, 8) in links
    assert not any(abs(a - b) < 2 for a, b in links)


def test_the_gradient_of_the_cost_is_its_derivative(box):
    clearance = Clearance.of(box, resting(0, 0.5, 0.0))
    q = postures(200)
    _, gradient = clearance.cost(q)
    step = 1e-6 * np.eye(7)
    numeric = np.stack([(clearance.cost(q + e)[0] - clearance.cost(q - e)[0]) / 2e-6 for e in step], axis=-1)
    # The field's slope is that of the nearest grid point: right but near the object's edges.
    assert np.median(np.abs(numeric - gradient).max(axis=-1)) < 1e-4
    touching = np.linalg.norm(gradient, axis=-1) > 0
    assert touching.any()
    cosine = (numeric * gradient).sum(-1) / np.maximum(
        np.linalg.norm(numeric, axis=-1) * np.linalg.norm(gradient, axis=-1), 1e-12
    )
    assert np.median(cosine[touching]) > 0.99


def test_cost_is_zero_exactly_beyond_the_margin(box):
    clearance = Clearance.of(box, resting(0, 0.5, 0.0), margin=0.02)
    q = postures(400)
    cost, _ = clearance.cost(q)
    apart = clearance.distances(q)
    assert ((cost == 0) == (apart >= 0.02)).all()


def test_an_arm_in_the_table_or_in_the_object_or_in_itself_is_told(box):
    clearance = Clearance.of(box, resting(0, 0.5, 0.0))
    assert clearance.distances(READY[None])[0] > 0.03
    low = READY.copy()
    low[1] = 1.4
    assert clearance.distances(low[None])[0] < 0.0
    hand = kin.forward_kinematics(READY[None])[0]
    around = Clearance.of(box, hand)
    assert around.distances(READY[None])[0] < -0.02
    folded = np.array([0.0, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0])
    assert clearance.distances(folded[None])[0] < 0.0


def test_a_hand_that_does_not_count_may_be_at_the_object(box):
    at_fingers = kin.forward_kinematics(READY[None])[0]
    at_fingers[:3, 3] += 0.19 * at_fingers[:3, 2]
    clearance = Clearance.of(box, at_fingers)
    assert clearance.distances(READY[None])[0] < 0.0
    assert clearance.distances(READY[None], hand=False)[0] > 0.0


def test_postures_do_not_change_each_others_distance(box):
    clearance = Clearance.of(box, resting(0, 0.5, 0.0))
    q = postures(50)
    together = clearance.distances(q)
    alone = np.concatenate([clearance.distances(each[None]) for each in q])
    assert together == pytest.approx(alone, abs=1e-12)
