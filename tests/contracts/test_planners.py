"""What every planner answers: plans that hold, a reason where there is none, and never an exception."""

from dataclasses import replace

import numpy as np
import pytest

from tests.planning.scenes import OBJECTS, draw_scenes, resting
from torchgrasp.errors import ConfigError
from torchgrasp.objects.gripper import hand_blocked, lowest_point
from torchgrasp.objects.surface import surface_points
from torchgrasp.planning import FunnelPlanner, GoalChoice, PlanStatus, StraightPlanner, TrajectoryPlanner
from torchgrasp.planning.goals import pose_distances
from torchgrasp.sim import kinematics as kin

READY, HORIZON = kin.READY_POSTURE, 30
PLANNERS = {
    "funnel": FunnelPlanner(),
    "straight": StraightPlanner(),
    "trajectory": TrajectoryPlanner(),
    "free": TrajectoryPlanner(num_steps="free"),
}
PROVING = {name: planner for name, planner in PLANNERS.items() if name != "straight"}
all_planners = pytest.mark.parametrize("planner", PLANNERS.values(), ids=PLANNERS)
proving_planners = pytest.mark.parametrize("planner", PROVING.values(), ids=PROVING)


@pytest.fixture(scope="module")
def scenes():
    return draw_scenes(6)


def plan(planner, scene, steps_left=HORIZON):
    return planner.plan(OBJECTS[scene.object_id], scene.T_base_object, scene.q, steps_left, HORIZON)


@all_planners
def test_a_plan_leads_from_the_arm_to_a_grasp_of_the_object(planner, scenes):
    for scene in scenes:
        found = plan(planner, scene)
        assert found.ok and found.reason == PlanStatus.OK.value and found.seconds > 0
        assert found.q.shape[0] == len(found.T_base_ee) <= HORIZON + 1
        assert found.q[0] == pytest.approx(scene.q)
        grasp = scene.T_base_object @ OBJECTS[scene.object_id].grasps[found.grasps.index[found.chosen]]
        assert found.T_base_goal == pytest.approx(grasp, abs=1e-6)
        assert np.linalg.norm(found.T_base_ee[-1, :3, 3] - grasp[:3, 3]) < 5e-3
        assert kin.forward_kinematics(found.q)[:, :3, 3] == pytest.approx(found.T_base_ee[:, :3, 3], abs=3e-3)
        assert len(found.penalty) == len(found.grasps)


@all_planners
def test_joint_limits_and_speeds_are_kept(planner, scenes):
    for scene in scenes:
        q = plan(planner, scene).q
        assert (q >= kin.JOINT_LOWER).all() and (q <= kin.JOINT_UPPER).all()
        assert (np.abs(np.diff(q, axis=0)) <= 0.15 * kin.JOINT_VELOCITY * 1.05).all()


@proving_planners
def test_the_hand_meets_neither_object_nor_table_on_its_way(planner, scenes):
    for scene in scenes:
        poses = plan(planner, scene).T_base_ee[1:]
        assert lowest_point(poses).min() > 0.0
        T_object_ee = np.linalg.solve(scene.T_base_object, poses)
        points = surface_points(OBJECTS[scene.object_id])
        assert not hand_blocked(points, T_object_ee, approach=0.0).any()


@all_planners
def test_plans_are_repeatable_and_leave_their_arguments_alone(planner, scenes):
    scene = scenes[0]
    q, pose = scene.q.copy(), scene.T_base_object.copy()
    first, second = plan(planner, scene), plan(planner, scene)
    assert np.array_equal(first.q, second.q) and np.array_equal(first.penalty, second.penalty)
    assert np.array_equal(scene.q, q) and np.array_equal(scene.T_base_object, pose)


@all_planners
def test_an_object_without_grasps(planner):
    item = replace(OBJECTS[0], grasps=OBJECTS[0].grasps[:0], grasp_quality=OBJECTS[0].grasp_quality[:0])
    found = planner.plan(item, resting(0, 0.5, 0.0), READY, HORIZON, HORIZON)
    assert found.status is PlanStatus.NO_GRASPS and not found.ok and len(found.grasps) == 0
    with pytest.raises(ValueError, match="no grasps"):
        _ = found.T_base_goal


@all_planners
def test_an_object_below_the_table(planner):
    pose = resting(0, 0.5, 0.0)
    pose[2, 3] = -0.5
    assert planner.plan(OBJECTS[0], pose, READY, HORIZON, HORIZON).status is PlanStatus.TABLE


@all_planners
def test_an_object_out_of_reach(planner):
    found = planner.plan(OBJECTS[0], resting(0, 3.0, 0.0), READY, HORIZON, HORIZON)
    assert found.status is PlanStatus.REACH and len(found.grasps) == 0


@proving_planners
def test_a_hand_that_starts_inside_the_object(planner):
    pose = kin.forward_kinematics(READY[None])[0]
    found = planner.plan(OBJECTS[0], pose, READY, HORIZON, HORIZON)
    assert found.status in (PlanStatus.START, PlanStatus.TABLE, PlanStatus.REACH)
    pose = resting(0, 0.5, 0.0)
    start = kin.sample_postures(_into(pose), READY)[0]
    assert planner.plan(OBJECTS[0], pose, start, HORIZON, HORIZON).status is PlanStatus.START


def _into(T_base_object):
    """The hand from above, its palm in the object's middle."""
    T_base_ee = kin.forward_kinematics(READY[None])[0]
    T_base_ee[:3, 3] = T_base_object[:3, 3] + (0.0, 0.0, 0.02)
    return T_base_ee


@proving_planners
def test_too_few_steps_left_to_get_there(planner, scenes):
    found = plan(planner, scenes[0], steps_left=1)
    assert found.status in (PlanStatus.BLOCKED, PlanStatus.STEPS) and not len(found.q)


@proving_planners
def test_a_spent_time_budget_is_told(planner, scenes):
    hurried = plan(replace(planner, budget=0.0), scenes[0])
    assert hurried.status is PlanStatus.TIME and hurried.seconds < 0.5
    with pytest.raises(ConfigError, match="budget"):
        replace(planner, budget=-1.0)


@pytest.mark.parametrize("steps_left", [4, 9, 16, 25])
@all_planners
def test_a_plan_ends_at_its_goal_within_the_steps_left(planner, scenes, steps_left):
    for scene in scenes[:3]:
        found = plan(planner, scene, steps_left)
        assert len(found.q) <= steps_left + 1
        if found.ok:
            assert np.linalg.norm(found.T_base_ee[-1, :3, 3] - found.T_base_goal[:3, 3]) < 5e-3


@all_planners
def test_any_posture_and_place_gets_an_answer(planner):
    rng = np.random.default_rng(0)
    for _ in range(40):
        q = rng.uniform(kin.JOINT_LOWER, kin.JOINT_UPPER)
        pose = resting(int(rng.integers(4)), *rng.uniform(-0.8, 0.8, 2))
        steps = int(rng.integers(1, HORIZON + 1))
        found = planner.plan(OBJECTS[0], pose, q, steps, HORIZON)
        assert found.ok == (len(found.q) > 0) or not planner.gives_path


@all_planners
def test_slow_control_steps_let_joints_turn_further(planner, scenes):
    scene = scenes[0]
    scene_of = (OBJECTS[scene.object_id], scene.T_base_object, scene.q, HORIZON, HORIZON)
    assert planner.plan(*scene_of, control_period=0.15).ok
    hurried = planner.plan(*scene_of, control_period=0.002)
    if isinstance(planner, FunnelPlanner):
        assert hurried.ok, "the law's pace is that of the hand"
    else:
        assert hurried.status is PlanStatus.STEPS


def test_the_grasp_pursued_is_kept_when_another_is_little_cheaper(scenes):
    scene = scenes[0]
    scene_of = (OBJECTS[scene.object_id], scene.T_base_object, scene.q, HORIZON, HORIZON)
    first = TrajectoryPlanner().plan(*scene_of)
    cost = pose_distances(first.T_base_ee[0], first.grasps.T_base_ee) + first.penalty
    others = [row for row in np.argsort(cost) if row != first.chosen and cost[row] < cost.min() + 0.08]
    assert others
    kept = TrajectoryPlanner().plan(*scene_of, pursued=int(first.grasps.index[others[0]]))
    assert kept.grasps.index[0] == first.grasps.index[others[0]]


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: GoalChoice(max_reached=0), "^max_reached"),
        (lambda: GoalChoice(loyalty=-1.0), "^loyalty"),
        (lambda: GoalChoice(quality_weight=float("nan")), "^quality_weight"),
        (lambda: TrajectoryPlanner(toll=float("nan")), "^toll"),
        (lambda: TrajectoryPlanner(num_goals=1.5), "^num_goals"),  # pyright: ignore
        (lambda: TrajectoryPlanner(num_steps="some"), "^num_steps"),  # pyright: ignore
        (lambda: FunnelPlanner(num_rollouts=0), "^num_rollouts"),
        (lambda: StraightPlanner(standoff=-0.1), "^standoff"),
    ],
)
def test_senseless_options_are_named(make, name):
    with pytest.raises(ConfigError, match=name):
        make()


def test_the_naive_planner_goes_through_what_others_go_around():
    hits = {"straight": 0, "trajectory": 0}
    for scene in draw_scenes(40):
        target = OBJECTS[scene.object_id]
        for name in hits:
            found = plan(PLANNERS[name], scene)
            T_object_ee = np.linalg.solve(scene.T_base_object, found.T_base_ee[1:])
            hits[name] += bool(hand_blocked(surface_points(target), T_object_ee, approach=0.0).any())
    assert hits["straight"] > 0 and hits["trajectory"] == 0


def test_the_last_part_of_a_trajectory_is_a_straight_approach(scenes):
    for scene in scenes:
        found = plan(TrajectoryPlanner(), scene)
        into_goal = np.linalg.inv(found.T_base_goal) @ found.T_base_ee
        near = into_goal[np.linalg.norm(into_goal[:, :3, 3], axis=-1) < 0.078]
        assert len(near) > 1
        assert np.abs(near[:, :2, 3]).max() < 4e-3 and (np.diff(near[:, 2, 3]) > -1e-4).all()
