"""The reset distribution."""

from dataclasses import replace

import numpy as np
import pytest

from torchgrasp.envs import StartPoses, StaticTarget
from torchgrasp.envs.scene import SceneSampler
from torchgrasp.envs.starts import touches
from torchgrasp.errors import ConfigError, ObjectError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.sim import Physics, Placement, SapienEngine
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.reach import clear_grasps, in_reach

OBJECTS = ProceduralObjects("train", num_objects=5, num_grasps=100)


def without_grasps(item):
    return replace(item, grasps=item.grasps[:0], grasp_quality=item.grasp_quality[:0])


def make_sampler(objects=OBJECTS, **start) -> SceneSampler:
    return SceneSampler(objects, physics=Physics(), start=StartPoses(**start), motion=StaticTarget())


@pytest.fixture(scope="module")
def scenes():
    sampler = make_sampler()
    return [sampler.sample(0, world, episode) for world in range(8) for episode in range(8)]


def hands(scenes) -> np.ndarray:
    return kin.forward_kinematics(np.stack([scene.q for scene in scenes]))


def test_the_hand_starts_20_to_50_cm_away_and_faces_the_object(scenes):
    T_base_ee = hands(scenes)
    centre = np.stack([scene.T_base_object[:3, 3] for scene in scenes])
    to_object = centre - T_base_ee[:, :3, 3]
    distance = np.linalg.norm(to_object, axis=-1)
    assert distance.min() > 0.2 - 1e-4 and distance.max() < 0.5 + 1e-4
    assert np.ptp(distance) > 0.2
    missed = np.linalg.norm(np.cross(to_object, T_base_ee[:, :3, 2]), axis=-1)
    assert missed.max() < 0.02 * np.sqrt(3) + 1e-4
    assert np.all((to_object * T_base_ee[:, :3, 2]).sum(-1) > 0)
    assert np.all(-to_object[:, 2] / distance > np.sin(0.35) - 1e-4)


def test_the_arm_starts_within_its_limits_and_clear_of_the_table(scenes):
    q = np.stack([scene.q for scene in scenes])
    assert np.all(q > kin.JOINT_LOWER + 0.05) and np.all(q < kin.JOINT_UPPER - 0.05)
    assert lowest_point(hands(scenes)).min() > 0.02
    assert kin.link_poses(q)[:, 2:7, 2, 3].min() > 0.05


def test_nothing_moves_while_the_arm_waits_at_its_start(scenes):
    for scene in scenes[::4]:
        world = SapienEngine().build(
            Placement(OBJECTS[scene.object_id], scene.T_base_object, scene.q, Physics())
        )
        for _ in range(4):
            world.drive(scene.q)
        assert world.joints[:7] == pytest.approx(scene.q, abs=2e-3)
        assert np.abs(world.T_base_object - scene.T_base_object)[:3, 3].max() < 3e-3


def test_every_scene_has_grasps_that_the_arm_reaches_clear_of_the_table(scenes):
    for scene in scenes[::8]:
        grasps = clear_grasps(OBJECTS[scene.object_id], scene.T_base_object)
        assert lowest_point(grasps.T_base_ee).min() > 0.004
        assert len(in_reach(grasps, kin.READY_POSTURE)) >= 8


def test_a_hand_before_the_middle_of_a_face_without_vertices_touches_it():
    box = next(item for item in OBJECTS if item.family == "box")
    half = np.array((0.4, 0.4, 0.2), np.float32)
    crate = replace(box, vertices=box.vertices / np.abs(box.vertices).max(0) * half, content_hash="crate")
    for gap, expected in ((0.005, True), (0.05, False)):
        T_base_ee = np.diag((1.0, -1.0, -1.0, 1.0))
        T_base_ee[2, 3] = 0.2 + 0.1129 + gap  # the pads end 0.1129 below the hand's origin
        assert touches(crate, np.eye(4), T_base_ee) == expected


def test_objects_places_and_turns_are_spread_out(scenes):
    assert {scene.object_id for scene in scenes} == set(range(len(OBJECTS)))
    where = np.stack([scene.T_base_object[:2, 3] for scene in scenes])
    assert where.min(0) == pytest.approx([0.40, -0.25], abs=0.05)
    assert where.max(0) == pytest.approx([0.65, 0.25], abs=0.05)
    rolls = np.arctan2(*hands(scenes)[:, :2, 0].T)
    assert np.histogram(rolls, bins=4, range=(-np.pi, np.pi))[0].min() > 3


def test_a_scene_follows_from_seed_world_and_episode_alone():
    fresh, used = make_sampler(), make_sampler()
    for episode in range(5):
        used.sample(1, 2, episode)
    a, b = fresh.sample(7, 3, 11), used.sample(7, 3, 11)
    assert a.object_id == b.object_id
    assert np.array_equal(a.T_base_object, b.T_base_object) and np.array_equal(a.q, b.q)
    for other in ((8, 3, 11), (7, 4, 11), (7, 3, 12), (3, 7, 11)):
        assert not np.array_equal(fresh.sample(*other).q, a.q)


def test_objects_that_cannot_be_grasped_where_they_rest_are_passed_over():
    sampler = make_sampler([without_grasps(OBJECTS[0]), OBJECTS[1]])
    assert {sampler.sample(0, 0, episode).object_id for episode in range(10)} == {1}


def test_an_impossible_set_is_refused_with_its_name():
    with pytest.raises(ObjectError, match="box-train-00000"):
        make_sampler([without_grasps(OBJECTS[0])]).sample(0, 0, 0)
    with pytest.raises(ObjectError, match="table_x"):
        make_sampler(OBJECTS[:1], table_x=(1.0, 1.1)).sample(0, 0, 0)
    with pytest.raises(ConfigError, match=r"^objects is empty"):
        make_sampler([])


@pytest.mark.parametrize(
    "options", [{"min_distance": 0.0}, {"min_distance": 0.4, "max_distance": 0.3}, {"aim": -0.1}]
)
def test_impossible_starts_are_refused(options):
    with pytest.raises(ConfigError, match=r"^(min_distance|max_distance|aim)="):
        StartPoses(**options)
