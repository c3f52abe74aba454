"""The compiled scene against the tables and against PhysX: masses, stops, frictions, what collides."""

from itertools import combinations

import mujoco
import numpy as np
import pytest

from tests.sim.test_sapien_world import find_body
from torchgrasp.objects import ProceduralObjects
from torchgrasp.objects.build import build_object
from torchgrasp.objects.solids import box
from torchgrasp.sim import MujocoEngine, Physics, Placement
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.mujoco.mujoco_world import MujocoWorld
from torchgrasp.sim.panda_tables import FINGER_INERTIAL, HAND_INERTIAL, IGNORE_BITS, INERTIALS

LINKS = (*(f"link{i}" for i in range(8)), "hand", "left_finger", "right_finger")


def make_world(target, **physics) -> MujocoWorld:
    pose = np.eye(4)
    pose[:3, 3] = (0.5, 0.3, 0.5)
    world = MujocoEngine().build(Placement(target, pose, kin.READY_POSTURE, Physics(**physics)))
    assert isinstance(world, MujocoWorld)
    return world


def test_links_weigh_what_the_tables_say_and_stand_where_kinematics_has_them(brick):
    world = make_world(brick)
    model, data = world._model, world._data
    inertials = (*INERTIALS, HAND_INERTIAL, FINGER_INERTIAL, FINGER_INERTIAL)
    assert [model.body(name).mass[0] for name in LINKS] == pytest.approx([each.mass for each in inertials])
    for name, inertial in zip(LINKS, inertials, strict=True):
        body, turn = model.body(name), np.zeros(9)
        mujoco.mju_quat2Mat(turn, body.iquat)
        turn = turn.reshape(3, 3)
        tensor = turn @ np.diag(body.inertia) @ turn.T
        assert np.diag(tensor) == pytest.approx(inertial.diagonal, rel=1e-5)
        assert tensor[(0, 0, 1), (1, 2, 2)] == pytest.approx(inertial.products, abs=1e-8)
        assert body.ipos == pytest.approx(inertial.centre)
    data.qpos[:7] = READY = kin.READY_POSTURE + 0.1
    mujoco.mj_kinematics(model, data)
    poses = kin.link_poses(READY[None])[0]
    for name, pose in zip((*(f"link{i}" for i in range(1, 8)), "hand"), poses, strict=True):
        assert data.body(name).xpos == pytest.approx(pose[:3, 3], abs=1e-9)
        assert data.body(name).xmat.reshape(3, 3) == pytest.approx(pose[:3, :3], abs=1e-9)


def test_limits_of_joints_are_the_robots(brick):
    model = make_world(brick, finger_force=30.0)._model
    assert model.jnt_range[:7] == pytest.approx(np.stack((kin.JOINT_LOWER, kin.JOINT_UPPER), -1))
    assert model.jnt_range[7:9] == pytest.approx(np.array([[0, 0.04], [0, 0.04]]))
    assert model.actuator_forcerange[7:] == pytest.approx(np.array([[-30, 30], [-30, 30]]))


def test_links_that_share_a_bit_never_collide_and_the_others_may(brick):
    model = make_world(brick)._model
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    for one, other in combinations(LINKS, 2):
        bits = [IGNORE_BITS["finger" if name.endswith("finger") else name] for name in (one, other)]
        ids = model.body(one).id, model.body(other).id
        pair = (min(ids), max(ids))
        assert (pair in excluded or pair[::-1] in excluded) == bool(bits[0] & bits[1]), (one, other)
        # MuJoCo leaves out parents and children by itself: no pair that PhysX has.
        if model.body_weldid[model.body_parentid[ids[1]]] == model.body_weldid[ids[0]] != 0:
            assert bits[0] & bits[1]


def test_two_materials_rub_with_the_mean_of_their_frictions_as_in_physx(brick):
    world = make_world(brick, friction=0.6, finger_friction=2.0)
    pose = np.eye(4)
    hand = kin.forward_kinematics(kin.READY_POSTURE[None])[0]
    pose[:3, 3] = hand[:3] @ (0.0, 0.03, 0.1037, 1.0)  # in a finger
    world.move_target(pose)
    mujoco.mj_forward(world._model, world._data)
    contacts = world._data.contact
    target = world._model.body("target").id
    touched = {
        world._model.body(world._model.geom_bodyid[geom]).name: friction[0]
        for geoms, friction in zip(contacts.geom, contacts.friction, strict=True)
        for geom in geoms
        if target in world._model.geom_bodyid[geoms] and world._model.geom_bodyid[geom] != target
    }
    assert touched["left_finger"] == pytest.approx(1.3)


@pytest.mark.parametrize("index", range(8))
def test_a_target_weighs_and_turns_as_in_physx(index):
    target = ProceduralObjects("train", num_objects=8, num_grasps=100)[index]
    body, other = make_world(target, mass=0.3)._model.body("target"), find_body(target, 0.3)
    assert body.mass[0] == pytest.approx(0.3)
    # PhysX rounds the vertices of its hulls.
    assert sorted(body.inertia) == pytest.approx(sorted(other.inertia), rel=0.02)


def test_damping_is_a_share_of_the_speed_whatever_the_object_weighs(brick):
    model = make_world(brick, mass=0.4, linear_damping=0.2, angular_damping=5.0)._model
    assert model.dof_damping[9:12] == pytest.approx([0.08] * 3)
    assert model.dof_damping[12:15] == pytest.approx(5.0 * model.body("target").inertia)


def test_what_is_as_flat_as_paper_has_a_model():
    flat = build_object(
        box((0.05, 0.06, 2e-4)),
        name="card",
        family="card",
        licence="MIT",
        num_grasps=1,
        rng=np.random.default_rng(0),
    )
    world = make_world(flat)
    for _ in range(3):
        world.drive(kin.READY_POSTURE)
    assert world.T_base_object[2, 3] < 0.45
