"""The expert as a policy."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.envs import GraspEnv
from torchgrasp.geometry import action_to_pose, goal_to_pose
from torchgrasp.objectives.functional import action_distance, pose_distance
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy, PlanStatus
from torchgrasp.sim import CameraIntrinsics, RaycastCamera

OBJECTS = ProceduralObjects("train", num_objects=8, num_grasps=200)
HORIZON = 30
LABELS = ("expert_action", "has_expert", "goal", "has_goal")


def make_env(num_envs: int, *, objects=OBJECTS, seed: int = 0, horizon: int = HORIZON) -> GraspEnv:
    torch.set_num_threads(1)
    camera = RaycastCamera(CameraIntrinsics(4, 4))
    return GraspEnv(num_envs, objects=objects, camera=camera, horizon=horizon, seed=seed)


def make_expert(**options) -> ExpertPolicy:
    return ExpertPolicy(options.pop("objects", OBJECTS), horizon=HORIZON, **options)


def roll_out(env, policy) -> TensorDict:
    return env.rollout(HORIZON, policy, break_when_any_done=False, break_when_all_done=True)


@pytest.fixture(scope="module")
def steps() -> TensorDict:
    return roll_out(make_env(10), make_expert())


def test_the_expert_lifts_nearly_every_object(steps):
    assert steps["next", "reward"][:, -1].sum() >= 9


def test_labels_have_the_keys_shapes_and_bounds_of_the_dictionary(steps):
    assert steps["has_expert"].all() and steps["has_goal"].all()
    assert steps["expert_action"].shape == (10, HORIZON, 6) and steps["goal"].shape == (10, HORIZON, 7)
    assert steps["has_goal"].dtype == steps["has_expert"].dtype == torch.bool
    assert torch.equal(steps["action"], steps["expert_action"])
    env = make_env(1)
    high = env.action_spec.space.high[0] if env.action_spec.space else None
    assert torch.all(steps["expert_action"].abs() <= high + 1e-6)
    assert torch.all(steps["goal"][..., 6] >= 0)
    assert torch.allclose(steps["goal"][..., 3:].norm(dim=-1), torch.tensor(1.0), atol=1e-5)


def test_the_goal_is_one_grasp_of_the_object_where_it_lies(steps):
    goal = steps["T_base_ee"] @ goal_to_pose(steps["goal"])
    T_object_goal = torch.linalg.solve(steps["T_base_object"], goal)
    for world in range(10):
        grasps = torch.from_numpy(OBJECTS[int(steps["object_id"][world, 0])].grasps)
        for pose in T_object_goal[world, ::10]:
            assert (grasps - pose).abs().amax((1, 2)).min() < 1e-4


def test_the_hand_ends_in_the_goal(steps):
    goal = (steps["T_base_ee"] @ goal_to_pose(steps["goal"]))[:, -1]
    distance = pose_distance(steps["next", "T_base_ee"][:, -1], goal)
    assert distance.median() < 0.005


def test_labels_continue_from_step_to_step(steps):
    jump = action_distance(steps["expert_action"][:, 1:], steps["expert_action"][:, :-1])
    assert jump.median() < 0.005 and jump.max() < 0.08


def test_asked_twice_the_expert_says_the_same(steps):
    assert_same_labels(roll_out(make_env(10), make_expert()), steps)


def test_a_second_run_of_the_same_episodes_gets_the_same_labels():
    env, expert = make_env(3), make_expert()
    env.set_seed(5, static_seed=True)
    first = roll_out(env, expert)
    env.set_seed(5, static_seed=True)
    assert_same_labels(roll_out(env, expert), first)


def test_an_episode_begun_again_is_begun_without_memory():
    state = make_env(8).reset()
    expert = make_expert()
    first = expert(state.clone())
    # The same episode later on, with the hand turned about so that other grasps are nearer.
    later = state.clone().set("time_left", state["time_left"] / 2)
    turn = action_to_pose(torch.tensor([0.0, 0.0, 0.1, 0.0, 0.0, 3.0]))
    other = expert(later.set("T_base_ee", state["T_base_ee"] @ turn))
    assert not torch.equal(other["goal"], first["goal"])
    assert torch.equal(expert(state.clone())["goal"], first["goal"])


def test_worlds_do_not_depend_on_their_neighbours(steps):
    alone = roll_out(make_env(1), make_expert())
    for key in (*LABELS, ("next", "reward")):
        assert torch.equal(alone[key][0], steps[key][0]), key


def assert_same_labels(a: TensorDict, b: TensorDict) -> None:
    for key in (*LABELS, ("next", "reward")):
        assert torch.equal(a[key], b[key]), key


def test_neighbouring_states_get_neighbouring_labels():
    env = make_env(8)
    state = env.reset()
    expert = make_expert(execute=False)
    here = expert(state.clone())
    nudge = torch.tensor([5e-4, -5e-4, 5e-4, 0.002, 0.0, -0.002]).expand(8, 6)
    moved = state.clone().set("T_base_ee", state["T_base_ee"] @ action_to_pose(nudge))
    there = expert(moved)
    assert action_distance(here["expert_action"], there["expert_action"]).max() < 0.004


def test_any_batch_shape_is_welcome():
    state = make_env(6).reset()
    flat = make_expert()(state.clone())
    grid = make_expert()(state.clone().reshape(2, 3))
    single = make_expert()(state[0].clone())
    for key in LABELS:
        assert torch.equal(grid[key].reshape(flat[key].shape), flat[key]), key
        assert torch.equal(single[key], flat[key][0]), key


def test_without_a_plan_labels_are_zero_and_a_reason_is_given():
    env = make_env(3)
    bare = [replace(item, grasps=item.grasps[:0], grasp_quality=item.grasp_quality[:0]) for item in OBJECTS]
    expert = make_expert(objects=bare)
    labels = expert(env.reset())
    assert not labels["has_expert"].any() and not labels["has_goal"].any()
    assert not labels["expert_action"].any() and not labels["goal"].any()
    assert expert.reasons == [PlanStatus.NO_GRASPS] * 3
    env.step(labels)  # the action is a legal one


def test_an_object_out_of_reach_leaves_its_neighbours_their_plans():
    state = make_env(3).reset()
    state["T_base_object"][1, 0, 3] = 3.0
    expert = make_expert()
    labels = expert(state)
    assert labels["has_expert"].flatten().tolist() == [True, False, True]
    assert [reason.name for reason in expert.reasons] == ["OK", "REACH", "OK"]


def test_a_moved_object_is_planned_for_again():
    state = make_env(1).reset()
    expert = make_expert()
    before = expert(state.clone())
    moved = state.clone()
    moved["T_base_object"][0, :3, 3] += torch.tensor([0.05, 0.05, 0.0])
    after = expert(moved)
    goals = [s["T_base_ee"] @ goal_to_pose(s["goal"]) for s in (before, after)]
    assert (goals[0] - goals[1]).abs().amax() > 0.02
    fresh = make_expert()(moved.clone())
    assert torch.equal(after["goal"], fresh["goal"])


def test_as_a_labeller_it_leaves_the_action_alone():
    state = make_env(2).reset()
    expert = make_expert(execute=False)
    assert "action" not in expert.out_keys
    action = torch.rand(2, 6)
    labels = expert(state.set("action", action.clone()))
    assert torch.equal(labels["action"], action)
    assert labels["expert_action"].any()


def test_what_it_returned_is_never_written_to_again():
    env, expert = make_env(2), make_expert()
    first = expert(env.reset())
    kept = first.select(*LABELS, "action").clone()
    expert(env.reset())
    for key in (*LABELS, "action"):
        assert torch.equal(first[key], kept[key])
    first["action"].zero_()
    assert first["expert_action"].any()
