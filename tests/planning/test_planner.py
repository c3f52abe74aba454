"""Grasp choice: statuses, reasons, and ways that are free."""

import numpy as np
import pytest
import torch

from tests.planning.scenes import OBJECTS, draw_scenes
from torchgrasp.objectives.functional import pose_distance
from torchgrasp.objects.gripper import hand_blocked, lowest_point
from torchgrasp.planning import FunnelPlanner, GoalChoice, PlanStatus
from torchgrasp.planning.goals import pose_distances
from torchgrasp.sim import kinematics as kin
from torchgrasp.sim.tracking import track_pose

READY = kin.READY_POSTURE
HORIZON = 30


@pytest.fixture(scope="module")
def scenes():
    return draw_scenes(6)


def plan(scene, *, steps_left: int = HORIZON, planner=None):
    planner = planner or FunnelPlanner()
    return planner.plan(OBJECTS[scene.object_id], scene.T_base_object, scene.q, steps_left, HORIZON)


def test_pose_distances_are_the_losses_pose_distance(scenes):
    goals = OBJECTS[0].grasps.astype(np.float64)
    T_base_ee = kin.forward_kinematics(READY[None])[0]
    expected = pose_distance(torch.from_numpy(T_base_ee), torch.from_numpy(goals)).numpy()
    assert pose_distances(T_base_ee, goals) == pytest.approx(expected, abs=1e-6)


def test_plans_hold_reachable_grasps_of_the_object_clear_of_the_table(scenes):
    for scene in scenes:
        found = plan(scene)
        assert found.ok and len(found.grasps) == len(found.penalty) > 0
        grasps = scene.T_base_object @ OBJECTS[scene.object_id].grasps[found.grasps.index]
        assert found.grasps.T_base_ee == pytest.approx(grasps, abs=1e-6)
        assert lowest_point(found.grasps.T_base_ee).min() > 0.0
        for pose in found.grasps.T_base_ee[:5]:
            assert len(kin.sample_postures(pose, scene.q))


def test_the_way_to_the_grasp_preferred_is_free_of_object_and_table(scenes):
    for scene in scenes:
        target = OBJECTS[scene.object_id]
        found = plan(scene)
        start = kin.forward_kinematics(scene.q[None])
        cost = pose_distances(start[0], found.grasps.T_base_ee) + found.penalty
        goal = found.grasps.T_base_ee[[np.argmin(cost)]]
        pose, q = start, scene.q[None]
        for t in range(HORIZON):
            pose = FunnelPlanner().funnel.next_pose(pose, goal, np.array([float(HORIZON - t)]), HORIZON)
            q, left = track_pose(q, pose)
            assert left[0] < 5e-3 and lowest_point(pose)[0] > 0
            T_object_ee = np.linalg.solve(scene.T_base_object, pose[0])[None]
            assert not hand_blocked(target.vertices, T_object_ee, approach=0.0)[0]
        assert pose == pytest.approx(goal, abs=3e-3)


def test_no_time_left_to_get_there(scenes):
    found = plan(scenes[0], steps_left=1)
    assert found.status is PlanStatus.BLOCKED and len(found.grasps) == 0


def test_each_status_tells_a_reason_of_its_own():
    assert len({status.value for status in PlanStatus}) == len(PlanStatus)
    assert all(status.value for status in PlanStatus)


def test_better_grasps_are_preferred_by_their_weight(scenes):
    scene = scenes[0]
    quality = OBJECTS[scene.object_id].grasp_quality
    found = plan(
        scene, planner=FunnelPlanner(choice=GoalChoice(quality_weight=0.5, clearance_weight=0.0), blocked=0.0)
    )
    assert found.penalty == pytest.approx(-0.5 * quality[found.grasps.index], abs=1e-6)
