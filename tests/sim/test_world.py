"""One world and a batch of them, in each engine: drives, contact, grasping, independence."""

import numpy as np
import pytest
import torch

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import pose_to_action
from torchgrasp.objects.build import build_object
from torchgrasp.objects.gripper import MIN_CLEAR_GRASPS, hand_boxes, lowest_point
from torchgrasp.objects.solids import cylinder
from torchgrasp.sim import CameraIntrinsics, Engine, Physics, Placement, RaycastCamera, Worlds
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.control import EeDelta
from torchgrasp.sim.reach import clear_grasps, in_reach
from torchgrasp.sim.settle import settle
from torchgrasp.sim.tracking import track_pose
from torchgrasp.sim.world import _HAND_CENTRE, _HAND_HALF, LIFTED, World

READY = kin.READY_POSTURE


def pose_at(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = (x, y, z)
    return pose


def hand_above(x: float, y: float, z: float) -> np.ndarray:
    """(4, 4) hand that points down with the fingers opening along the base's y."""
    return pose_at(x, y, z) @ np.diag([1.0, -1.0, -1.0, 1.0])


def test_the_box_of_the_open_hand_holds_all_its_parts():
    """Within it the physics runs finer."""
    low, high = _HAND_CENTRE - _HAND_HALF, _HAND_CENTRE + _HAND_HALF
    for half_x, outer, rear, front in hand_boxes():
        assert (high[:2] >= (half_x, outer)).all() and low[2] <= rear and front <= high[2]


def posture_at(T_base_ee: np.ndarray) -> np.ndarray:
    return kin.sample_postures(T_base_ee, READY)[0]


CAMERA = RaycastCamera(CameraIntrinsics(16, 16))
EE = EeDelta()


def make_world(
    engine: Engine, physics: Physics, target, T_base_object: np.ndarray, q: np.ndarray, **options
) -> World:
    return engine.build(Placement(target, T_base_object, q, physics, **options))


def place(worlds: Worlds, row: int, target, T_base_object: np.ndarray, q: np.ndarray) -> None:
    worlds.place(row, Placement(target, T_base_object, q, Physics()))


def step(worlds: Worlds, row: int, change: np.ndarray) -> None:
    """One control step of a world by a pose relative to its hand."""
    action = pose_to_action(torch.from_numpy(change)).numpy()[None]
    q = EE.posture(worlds.joints[[row], :7], worlds.T_base_ee[[row]], action)
    worlds.drive(q, [row])


def test_the_hand_follows_a_smooth_path_within_little_more_than_a_millimetre(engine, brick):
    world = make_world(
        engine, Physics(), brick, pose_at(0.5, 0.3, 0.04), posture_at(hand_above(0.5, -0.2, 0.4))
    )
    q = world.joints[None, :7]
    for step in range(1, 14):  # 0.1 m/s along y
        wanted = hand_above(0.5, -0.2 + 0.015 * step, 0.4)[None]
        q, left = track_pose(q, wanted)
        assert left[0] < 1e-5
        world.drive(q[0])
        reached = kin.forward_kinematics(world.joints[None, :7])
        assert np.abs(kin.pose_error(reached, wanted)[0, :3]).max() < 1.2e-3
        assert np.abs(kin.pose_error(reached, wanted)[0, 3:]).max() < 5e-3


def test_a_step_relative_to_the_hand_is_made_within_little_more_than_a_millimetre(engine, brick):
    worlds = Worlds(1, engine=engine)
    place(worlds, 0, brick, pose_at(0.5, 0.3, 0.04), posture_at(hand_above(0.5, -0.2, 0.4)))
    for _ in range(10):
        wanted = worlds.T_base_ee @ pose_at(0.0, 0.0, 0.015)
        step(worlds, 0, pose_at(0.0, 0.0, 0.015))
        assert np.abs(worlds.T_base_ee[0] - wanted[0]).max() < 1.2e-3


def test_the_controller_holds_the_hand_off_the_table(engine, brick):
    worlds = Worlds(1, engine=engine)
    place(worlds, 0, brick, pose_at(0.5, 0.3, 0.04), posture_at(hand_above(0.5, -0.2, 0.25)))
    for _ in range(12):
        step(worlds, 0, pose_at(0.01, 0.0, 0.05))
        assert lowest_point(worlds.T_base_ee)[0] > -1e-4
    assert lowest_point(worlds.T_base_ee)[0] < 0.01


def test_no_step_turns_a_joint_faster_than_it_may(engine, brick):
    world = make_world(engine, Physics(), brick, pose_at(0.5, 0.3, 0.04), READY)
    target = READY.copy()
    target[0] += 2.0
    world.drive(target)
    assert world.joints[0] - READY[0] <= kin.JOINT_VELOCITY[0] * 0.15 + 1e-3
    assert world.joints[0] - READY[0] > 0.2


def test_a_wrist_that_is_turned_to_and_fro_arrives_each_time(engine, brick):
    world = make_world(engine, Physics(), brick, pose_at(0.5, 0.4, 0.04), READY)
    lag = []
    for i in range(12):
        to = READY + np.where(np.arange(7) >= 4, 0.1 * (-1) ** i, 0.0)
        world.drive(to)
        lag.append(np.abs(world.joints[:7] - to).max())
    assert max(lag[1:]) < 0.02


def test_gripping_and_lifting_a_box_returns_its_rise(engine, brick):
    worlds = Worlds(2, engine=engine)
    grasp = hand_above(0.5, 0.0, 0.04 + 0.1034)
    place(worlds, 0, brick, pose_at(0.5, 0.0, 0.04), posture_at(grasp))
    place(worlds, 1, brick, pose_at(0.5, 0.3, 0.04), posture_at(grasp))  # nothing between the fingers
    rise = worlds.close_and_lift([0, 1])
    assert rise == pytest.approx([0.15, 0.0], abs=0.01)
    assert worlds.T_base_object[0, 2, 3] - 0.04 == pytest.approx(rise[0], abs=1e-3)
    assert worlds.joints[0, 7:].sum() == pytest.approx(0.06, abs=2e-3)  # the brick is 6 cm wide along y
    assert worlds.joints[1, 7:] == pytest.approx([0, 0], abs=2e-3)


def test_without_friction_between_the_pads_nothing_is_lifted(engine, brick):
    world = make_world(
        engine,
        Physics(friction=0.0, finger_friction=0.0),
        brick,
        pose_at(0.5, 0.0, 0.04),
        posture_at(hand_above(0.5, 0.0, 0.04 + 0.1034)),
    )
    world.close_fingers()
    list(world.lift())
    assert world.T_base_object[2, 3] < 0.08


def test_a_falling_object_falls_as_gravity_says(engine, brick):
    physics = Physics(linear_damping=0.0, free_rate=240)
    world = make_world(engine, physics, brick, pose_at(0.5, 0.3, 1.0), READY)
    world.drive(READY)
    fallen = 1.0 - world.T_base_object[2, 3]
    assert fallen == pytest.approx(9.81 / 2 * 0.15**2, rel=0.07)  # a step of 1/240 s is first order


def test_a_round_object_stops(engine, ball):
    moved = []
    world = make_world(engine, Physics(), ball, pose_at(0.5, 0.3, ball.size.max() / 2 + 0.01), READY)
    for _ in range(40):  # 6 s
        before = world.T_base_object[:3, 3]
        world.drive(READY)
        moved.append(np.abs(world.T_base_object[:3, 3] - before).max())
    assert max(moved[:10]) > 1e-3 and moved[-1] < 1e-4


def test_the_tables_edge_is_where_it_is_said_to_be(engine, brick):
    heights = []
    for y in (0.60, 0.72):
        world = make_world(engine, Physics(), brick, pose_at(0.5, y, 0.04), READY)
        for _ in range(5):
            world.drive(READY)
        heights.append(world.T_base_object[2, 3])
    assert heights[0] == pytest.approx(0.04, abs=1e-3) and heights[1] < -0.5


def test_an_episode_depends_on_nothing_that_was_simulated_before(engine, brick, can):
    def episode(worlds: Worlds, row: int) -> list[np.ndarray]:
        place(worlds, row, brick, pose_at(0.5, 0.0, 0.05), posture_at(hand_above(0.5, 0.0, 0.16)))
        out = []
        for _ in range(3):
            step(worlds, row, pose_at(0.002, 0.03, 0.01))
            pictures = worlds.observe(CAMERA)
            out += [worlds.joints[row], worlds.T_base_object[row], *(each[row] for each in pictures.values())]
        return [*out, worlds.close_and_lift([row])]

    alone = Worlds(1, engine=engine)
    first = episode(alone, 0)
    used = Worlds(3, engine=engine)
    for row in range(3):
        place(used, row, can, pose_at(0.5, 0.1, 0.05), READY)
    used.close_and_lift([0, 2])
    for other in (episode(alone, 0), episode(used, 2)):
        assert all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_worlds_that_are_not_named_stand_still(engine, brick):
    worlds = Worlds(3, engine=engine)
    for row in range(3):
        place(worlds, row, brick, pose_at(0.5, 0.3, 0.04), READY)
    before = worlds.joints
    step(worlds, 1, pose_at(0, 0, 0.02))
    worlds.drive(np.empty((0, 7)), [])
    moved = np.abs(worlds.joints - before).max(-1)
    assert moved[0] == moved[2] == 0.0 and moved[1] > 1e-3


def test_reads_are_copies(engine, brick):
    worlds = Worlds(1, engine=engine)
    place(worlds, 0, brick, pose_at(0.5, 0.3, 0.04), READY)
    reads = [worlds.joints, worlds.T_base_ee, worlds.T_base_object, *worlds.observe(CAMERA).values()]
    kept = [read.copy() for read in reads]
    step(worlds, 0, pose_at(0.02, 0, 0.02))
    worlds.observe(CAMERA)
    assert all(np.array_equal(a, b) for a, b in zip(reads, kept, strict=True))


def test_worlds_need_an_object_first(engine):
    with pytest.raises(RuntimeError, match="place"):
        Worlds(2, engine=engine).observe(CAMERA)


@pytest.mark.parametrize("name, value", [("mass", 0.0), ("friction", -1.0), ("control_period", float("nan"))])
def test_impossible_physics_is_refused_by_name(name, value):
    with pytest.raises(ConfigError, match=f"^{name}="):
        Physics(**{name: value})


def test_a_pen_is_picked_up_by_the_finger_tips(engine):
    pen = build_object(
        cylinder(0.006, 0.136),
        name="pen",
        family="pen",
        licence="MIT",
        num_grasps=400,
        rng=np.random.default_rng(0),
    )
    held = []
    for rest in settle(pen, Physics()):
        pose = pose_at(0.5, 0.0, 0.0) @ rest
        clear = clear_grasps(pen, pose)
        if len(clear) >= MIN_CLEAR_GRASPS:
            for q in in_reach(clear, READY, at_most=8).postures:
                world = make_world(engine, Physics(), pen, pose, q[0])
                world.close_fingers()
                for _ in world.lift():
                    pass
                held.append(world.T_base_object[2, 3] - pose[2, 3] > LIFTED)
    assert len(held) >= 8 and np.mean(held) >= 0.9


def close_on_brick(engine: Engine, brick, **physics) -> float:
    """Metres that a brick of 6 cm between the fingers rises in lifting."""
    grasp = posture_at(hand_above(0.5, 0.0, 0.04 + 0.1034))
    world = make_world(engine, Physics(**physics), brick, pose_at(0.5, 0.0, 0.04), grasp)
    world.close_fingers()
    list(world.lift())
    return float(world.T_base_object[2, 3] - 0.04)


def test_fingers_hold_as_much_as_their_friction_and_force_carry(engine, brick):
    slippery = {"friction": 0.1, "finger_friction": 0.1}  # two fingers of 40 N carry 8 N
    assert close_on_brick(engine, brick, **slippery, mass=0.3) == pytest.approx(0.15, abs=0.03)
    assert close_on_brick(engine, brick, **slippery, mass=1.6) < LIFTED
    assert close_on_brick(engine, brick, mass=1.6) == pytest.approx(0.15, abs=0.03)


def test_a_held_target_stands_in_the_air_and_is_carried_where_it_is_told(engine, brick):
    start, end = pose_at(0.5, 0.3, 0.5), pose_at(0.55, 0.25, 0.45)
    end[:3, :3] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    world = make_world(engine, Physics(), brick, start, READY, held=True)
    world.drive(READY)
    assert world.held and world.T_base_object == pytest.approx(start, abs=1e-6)
    world.move_target(end)
    assert world.T_base_object == pytest.approx(start, abs=1e-6)
    world.drive(READY)
    assert world.T_base_object == pytest.approx(end, abs=1e-5)


def test_a_held_target_withstands_the_fingers_and_is_let_go_when_they_have_closed(engine, brick):
    aside = hand_above(0.5, 0.01, 0.5 + 0.1034)  # one finger meets it before the other does
    world = make_world(engine, Physics(), brick, pose_at(0.5, 0.0, 0.5), posture_at(aside), held=True)
    world.close_fingers()
    assert not world.held
    assert np.abs(world.T_base_object[:3, 3] - (0.5, 0.0, 0.5)).max() < 0.012
    list(world.lift())
    assert world.T_base_object[2, 3] == pytest.approx(0.65, abs=0.01)
    dropped = make_world(engine, Physics(), brick, pose_at(0.5, 0.3, 0.5), READY, held=True)
    dropped.close_fingers()
    dropped.drive(READY)
    dropped.drive(READY)
    assert dropped.T_base_object[2, 3] < 0.4


def test_what_is_not_held_is_put_where_it_is_told_and_lies_at_rest(engine, brick):
    world = make_world(engine, Physics(), brick, pose_at(0.5, 0.3, 0.3), READY)
    world.drive(READY)  # it falls
    world.move_target(pose_at(0.6, -0.3, 0.04))
    assert world.T_base_object[:3, 3] == pytest.approx([0.6, -0.3, 0.04], abs=1e-6)
    world.drive(READY)
    assert world.T_base_object[:3, 3] == pytest.approx([0.6, -0.3, 0.04], abs=5e-4)


def test_a_copy_begins_where_its_world_is_and_leaves_it_alone(engine, brick):
    world = make_world(
        engine, Physics(), brick, pose_at(0.5, 0.0, 0.04), posture_at(hand_above(0.5, 0.0, 0.3))
    )
    world.drive(world.joints[:7] + 0.05)
    joints, pose = world.joints, world.T_base_object
    other = engine.build(world.place_again())
    assert type(other) is type(world)
    assert other.joints == pytest.approx(joints, abs=5e-5)
    assert other.T_base_object == pytest.approx(pose, abs=1e-6)
    other.drive(READY)
    list(other.lift())
    assert np.array_equal(world.joints, joints) and np.array_equal(world.T_base_object, pose)


def test_tried_last_steps_leave_the_world_as_it_is_and_tell_what_would_be_lifted(engine, brick):
    grasp = posture_at(hand_above(0.5, 0.0, 0.04 + 0.1034))
    worlds, untried = Worlds(1, engine=engine), Worlds(1, engine=engine)
    for each in (worlds, untried):
        place(each, 0, brick, pose_at(0.5, 0.0, 0.04), grasp)
    away = posture_at(hand_above(0.5, 0.0, 0.04 + 0.1634))
    rises = worlds.try_last(0, np.stack((grasp, away)))
    assert rises == pytest.approx([0.15, 0.0], abs=0.02)
    assert np.array_equal(worlds.close_and_lift([0]), untried.close_and_lift([0]))
