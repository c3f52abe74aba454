"""Laws: what they are told, and when they ask for a new plan."""

import numpy as np
import pytest
import torch

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose, goal_to_pose
from torchgrasp.objectives.functional import action_distance
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import (
    ExpertPolicy,
    Funnel,
    FunnelPlanner,
    PathFollower,
    PlanStatus,
    StraightPlanner,
    TrajectoryPlanner,
)
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.sim.kinematics import READY_POSTURE, forward_kinematics, sample_postures

OBJECTS = ProceduralObjects("train", num_objects=8, num_grasps=200)
HORIZON = 30
VARIANTS = {
    "trajectory": (TrajectoryPlanner(), PathFollower()),
    "trajectory_funnel": (TrajectoryPlanner(), Funnel()),
    "straight": (StraightPlanner(), PathFollower()),
}
variants = pytest.mark.parametrize(("planner", "law"), VARIANTS.values(), ids=VARIANTS)


def make_env(num_envs: int, **options) -> GraspEnv:
    torch.set_num_threads(1)
    camera = RaycastCamera(CameraIntrinsics(4, 4))
    return GraspEnv(num_envs, objects=OBJECTS, camera=camera, horizon=HORIZON, seed=0, **options)


def roll_out(env, policy):
    return env.rollout(HORIZON, policy, break_when_any_done=False, break_when_all_done=True)


@variants
def test_every_pair_of_planner_and_law_labels_and_lifts(planner, law):
    expert = ExpertPolicy(OBJECTS, horizon=HORIZON, planner=planner, law=law)
    steps = roll_out(make_env(8), expert)
    assert steps["has_expert"].all() and steps["has_goal"].all()
    assert steps["next", "reward"][:, -1].sum() >= 6
    assert steps["expert_action"].abs().amax((0, 1))[:3].max() <= 0.06


@pytest.mark.parametrize("action_space", ["joint_delta", "joint_velocity"])
def test_paths_are_followed_in_joint_actions_too(action_space):
    env = make_env(6, action_space=action_space)
    expert = ExpertPolicy(
        OBJECTS, horizon=HORIZON, planner=TrajectoryPlanner(), law=PathFollower(), action_space=env.actions
    )
    assert roll_out(env, expert)["next", "reward"][:, -1].sum() >= 5


def test_the_hand_follows_the_planned_poses():
    env = make_env(4)
    expert = ExpertPolicy(OBJECTS, horizon=HORIZON, planner=TrajectoryPlanner(), law=PathFollower())
    steps = roll_out(env, expert)
    scene = env.scene(0, 0)
    plan = TrajectoryPlanner().plan(OBJECTS[scene.object_id], scene.T_base_object, scene.q, HORIZON, HORIZON)
    hand = steps["T_base_ee"][0, : len(plan.T_base_ee), :3, 3].numpy()
    assert np.abs(hand - plan.T_base_ee[:HORIZON, :3, 3]).max() < 5e-3
    goal = (steps["T_base_ee"] @ goal_to_pose(steps["goal"]))[0, 0].numpy()
    assert goal == pytest.approx(plan.T_base_goal, abs=1e-4)


def test_a_hand_that_was_pushed_off_the_path_gets_a_new_one():
    env = make_env(1)
    expert = ExpertPolicy(OBJECTS, horizon=HORIZON, planner=TrajectoryPlanner(), law=PathFollower())
    state = env.reset()
    before = expert(state.clone())
    plan = expert._pursuits[0].plan
    moved = env.step(before)["next"]
    assert expert(moved.clone()) is not None and expert._pursuits[0].plan is plan, "on its way: the same plan"
    push = action_to_pose(torch.tensor([0.03, 0.0, 0.0, 0.0, 0.0, 0.0]))
    moved["T_base_ee"] = moved["T_base_ee"] @ push
    expert(moved)
    assert expert._pursuits[0].plan is not plan


def test_without_a_new_way_the_expert_goes_on_to_the_grasp_it_knew():
    env = make_env(1)
    expert = ExpertPolicy(OBJECTS, horizon=HORIZON)
    state = expert(env.reset())
    late = state.clone()
    late["time_left"] = torch.full((1, 1), 1 / HORIZON)
    late["T_base_object"][0, 0, 3] += 0.025
    labels = expert(late)
    assert labels["has_expert"].all()
    T_object_goal = torch.linalg.solve(
        late["T_base_object"], labels["T_base_ee"] @ goal_to_pose(labels["goal"])
    )
    grasps = torch.from_numpy(OBJECTS[int(state["object_id"][0])].grasps)
    assert (grasps - T_object_goal).abs().amax((1, 2)).min() < 1e-4


def test_a_late_hand_is_led_by_the_fallback_where_the_planner_finds_no_path():
    env = make_env(6)
    state = env.reset()
    late = state.clone()
    late["time_left"] = torch.full((6, 1), 7 / HORIZON)
    alone = ExpertPolicy(OBJECTS, horizon=HORIZON, planner=TrajectoryPlanner())
    backed = ExpertPolicy(OBJECTS, horizon=HORIZON, planner=TrajectoryPlanner(), fallback=FunnelPlanner())
    funnel = ExpertPolicy(OBJECTS, horizon=HORIZON, planner=FunnelPlanner())
    has = [expert(late.clone())["has_expert"][:, 0] for expert in (alone, backed, funnel)]
    assert torch.equal(has[1], has[0] | has[2])
    assert has[1].sum() > has[0].sum()
    labels = [expert(late.clone())["expert_action"] for expert in (alone, backed, funnel)]
    assert torch.equal(labels[1], torch.where(has[0][:, None], labels[0], labels[2]))


def test_world_numbers_tell_worlds_apart_wherever_they_stand_in_the_batch():
    env = make_env(3)
    expert = ExpertPolicy(OBJECTS, horizon=HORIZON)
    first = expert(env.reset())
    swapped = expert(first.select(*expert.in_keys)[[2, 0, 1]])
    assert torch.equal(swapped["goal"], first["goal"][[2, 0, 1]])


def test_senseless_tolerances_are_refused():
    with pytest.raises(ConfigError, match=r"^max_offset=-1"):
        PathFollower(max_offset=-1.0)


def test_a_path_ends_where_its_last_pose_is():
    scene = make_env(1).scene(0, 0)
    plan = TrajectoryPlanner(num_steps="free").plan(
        OBJECTS[scene.object_id], scene.T_base_object, scene.q, HORIZON, HORIZON
    )
    assert len(plan.q) < HORIZON
    assert forward_kinematics(plan.q[-1:])[0] == pytest.approx(plan.T_base_goal, abs=5e-3)


def test_a_path_cannot_be_followed_where_the_planner_has_none():
    with pytest.raises(ConfigError, match="prove=True"):
        ExpertPolicy(OBJECTS, horizon=HORIZON, planner=FunnelPlanner(prove=False), law=PathFollower())


def test_labels_stay_inside_the_bounds_however_far_the_path_is():
    env = make_env(2)
    expert = ExpertPolicy(OBJECTS, horizon=HORIZON, planner=TrajectoryPlanner(), law=PathFollower())
    state = expert(env.reset())
    far = state.clone()
    far["time_left"] = torch.full((2, 1), 1 / HORIZON)
    away = action_to_pose(torch.tensor([0.0, 0.1, -0.2, 0.0, 0.0, 1.5]))
    far["T_base_ee"] = far["T_base_ee"] @ away
    labels = expert(far)
    assert labels["has_expert"].all()
    action = labels["expert_action"]
    assert action[:, :3].norm(dim=-1).max() <= 0.0551 and action[:, 3:].abs().max() <= 0.46


def test_an_expert_that_found_no_way_asks_again_some_steps_later():
    env = make_env(1)
    expert = ExpertPolicy(OBJECTS, horizon=HORIZON)
    state = env.reset()
    inside = forward_kinematics(READY_POSTURE[None])[0]
    inside[:3, 3] = state["T_base_object"][0, :3, 3].numpy()
    inside[2, 3] += 0.02
    stuck = state.clone()
    stuck["joints"][0, :7] = torch.from_numpy(sample_postures(inside, READY_POSTURE)[0])
    stuck["T_base_ee"][0] = torch.from_numpy(inside)
    assert not expert(stuck)["has_expert"].any() and expert.reasons == [PlanStatus.START]
    found = []
    for steps_left in (29, 28, 27, 26):
        state["time_left"] = torch.full((1, 1), steps_left / HORIZON)
        found.append(bool(expert(state.clone())["has_expert"]))
    assert found == [False, False, True, True]


def test_neighbouring_states_get_neighbouring_labels_when_each_is_planned_for_anew():
    env = make_env(8)
    state = env.reset()
    near = state.clone()
    joints = near["joints"].clone()
    joints[:, :7] += 0.002
    near["joints"] = joints
    hand = torch.from_numpy(forward_kinematics(joints[:, :7].double().numpy())).float()
    near["T_base_ee"] = hand
    labels = [ExpertPolicy(OBJECTS, horizon=HORIZON)(each)["expert_action"] for each in (state, near)]
    assert action_distance(*labels).median() < 0.003
