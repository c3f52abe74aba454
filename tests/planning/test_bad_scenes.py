"""Scenes without a way to a grasp: every policy that plans stays legal, and says why."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy, OpenLoopPolicy, PlanStatus
from torchgrasp.rollouts.episode_pool import SerialPool
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.sim import kinematics as kin

OBJECTS = ProceduralObjects("train", num_objects=4, num_grasps=100)
BARE = [replace(item, grasps=item.grasps[:0], grasp_quality=item.grasp_quality[:0]) for item in OBJECTS]
POLICIES = [ExpertPolicy, OpenLoopPolicy]
HORIZON = 30


def make_env() -> GraspEnv:
    torch.set_num_threads(1)
    return GraspEnv(2, objects=OBJECTS, camera=RaycastCamera(CameraIntrinsics(4, 4)), horizon=HORIZON, seed=0)


def put_hand(state: TensorDict, T_base_ee: np.ndarray) -> TensorDict:
    """The state with world 0's arm in a posture of that hand pose."""
    q = kin.sample_postures(T_base_ee, kin.READY_POSTURE)[0]
    state["joints"][0, :7] = torch.from_numpy(q)
    state["T_base_ee"][0] = torch.from_numpy(kin.forward_kinematics(q[None])[0])
    return state


def looking_down(x: float, y: float, z: float) -> np.ndarray:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = x, y, z
    return pose


def out_of_reach(state: TensorDict) -> TensorDict:
    state["T_base_object"][0, 0, 3] = 3.0
    return state


def below_the_table(state: TensorDict) -> TensorDict:
    state["T_base_object"][0, 2, 3] -= 0.5
    return state


def behind_the_base(state: TensorDict) -> TensorDict:
    """Where the arm has no posture for any grasp, though it is near."""
    state["T_base_object"][0, :2, 3] = torch.tensor([0.0, 0.0])
    return state


def hand_in_the_table(state: TensorDict) -> TensorDict:
    return put_hand(state, looking_down(0.5, 0.0, 0.03))


def hand_in_the_object(state: TensorDict) -> TensorDict:
    x, y, z = state["T_base_object"][0, :3, 3].tolist()
    raised = state["T_base_object"][0].clone()
    raised[2, 3] = z + 0.2
    state["T_base_object"][0] = raised
    return put_hand(state, looking_down(x, y, z + 0.2))


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize(
    ("spoil", "status"),
    [
        (out_of_reach, PlanStatus.REACH),
        (behind_the_base, PlanStatus.REACH),
        (below_the_table, PlanStatus.TABLE),
        (hand_in_the_table, PlanStatus.START),
        (hand_in_the_object, PlanStatus.START),
    ],
)
def test_a_bad_scene_is_named_and_leaves_its_neighbour_alone(policy, spoil, status):
    env = make_env()
    state = spoil(env.reset())
    acted = policy(OBJECTS, horizon=HORIZON)(state.clone())
    assert acted["plan_status"].flatten().tolist() == [status.number, PlanStatus.OK.number]
    assert not acted["action"][0].any() and acted["action"][1].any()
    if policy is ExpertPolicy:
        assert acted["has_expert"].flatten().tolist() == [False, True]
        assert acted["has_goal"].flatten().tolist() == [False, True]
    env.step(acted)


@pytest.mark.parametrize("policy", POLICIES)
def test_an_object_with_an_empty_grasp_set_fails_by_name(policy):
    with SerialPool({"test": lambda: TransformedEnv(make_env())}) as pool:
        (episodes,) = pool.run("test", policy(BARE, horizon=HORIZON), [0])
    for episode in episodes:
        assert not episode.success and len(episode.steps) == HORIZON
        assert episode.failure == f"no plan: {PlanStatus.NO_GRASPS.reason}"
        hand = episode.steps["next", "T_base_ee"][:, :3, 3]
        assert (hand - hand[0]).norm(dim=-1).max() < 1e-3  # it holds still
