"""GraspAgent beside the environment that its policy was trained in, and what it says of bad input."""

import functools
import subprocess
import sys

import numpy as np
import pytest
import torch
from torchrl.envs.utils import step_mdp

import torchgrasp
from torchgrasp import keys
from torchgrasp.deploy import GraspAgent
from torchgrasp.errors import ConfigError, PictureError
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import RaycastCamera
from torchgrasp.sim.kinematics import READY_POSTURE, forward_kinematics

WORLDS = 3
CAMERA = CameraIntrinsics()


@functools.cache
def policy():
    torch.set_num_threads(1)
    return torchgrasp.load_policy("pretrained")


@functools.cache
def objects():
    return ProceduralObjects("val", num_objects=3, num_grasps=100)


def make_env(motion="static", **options):
    return torchgrasp.make_env(
        policy(), objects=objects(), num_envs=WORLDS, seed=2, target_motion=motion, **options
    )


def shown(state):
    """What an environment's state tells a camera and an arm."""
    return {
        "depth": state[keys.DEPTH].numpy(),
        "mask": state[keys.MASK].numpy(),
        "joints": state["joints"].numpy(),
        "T_base_ee": state["T_base_ee"].numpy(),
        "T_base_camera": state["T_base_camera"].numpy(),
    }


@pytest.mark.parametrize("motion", ["static", "jitter", "handover"])
def test_the_agent_gives_the_actions_of_the_environment(motion):
    env = make_env(motion)
    agent = GraspAgent(policy(), intrinsics=CAMERA, thin=1, num_arms=WORLDS, holes_are_empty=True)
    acted = 0
    for _ in range(2):
        state = env.reset()
        agent.reset()
        for step in range(env.horizon):
            state = policy()(state)
            command = agent.act(**shown(state))
            acts = [problem is None for problem in command.problems]
            acted += sum(acts)
            assert np.abs(command.action - state["action"].numpy())[acts].max(initial=0.0) <= 1e-6
            assert command.num_points[acts].tolist() == state["num_points"].flatten()[acts].tolist()
            assert command.close.tolist() == [step == env.horizon - 1] * WORLDS
            state = step_mdp(env.step(state))
    assert acted == 2 * WORLDS * env.horizon


def test_the_hand_goes_where_the_environment_s_controller_sends_it():
    env = make_env()
    agent = GraspAgent(policy(), intrinsics=CAMERA, num_arms=WORLDS, holes_are_empty=True)
    state = env.reset()
    for _ in range(5):
        command = agent.act(**shown(state))
        state["action"] = torch.from_numpy(command.action)
        state = step_mdp(env.step(state))
        # Drives follow within millimetres in a step of 0.15 s.
        assert np.abs(state["T_base_ee"].numpy() - command.T_base_ee)[..., :3, 3].max() < 0.02


def test_a_camera_of_another_size_and_view_grasps_by_options_alone():
    """848 x 480 and 69 degrees wide, as a RealSense; millimetres, with a hole in every third pixel."""
    fx = 424 / np.tan(np.radians(69) / 2)
    camera = CameraIntrinsics(848, 480, fx=fx, cx=430.0, cy=236.0)
    T_ee_camera = RaycastCamera().T_ee_camera
    env = make_env(camera=RaycastCamera(camera))
    agent = GraspAgent(policy(), intrinsics=camera, T_ee_camera=T_ee_camera, num_arms=WORLDS)
    lifted, rng = 0.0, np.random.default_rng(0)
    for _ in range(2):
        state = env.reset()
        agent.reset()
        for _ in range(env.horizon):
            depth = (state[keys.DEPTH].numpy() * 1000).astype(np.uint16)
            depth[rng.random(depth.shape) < 0.3] = 0
            command = agent.act(depth, state[keys.MASK].numpy(), joints=state["joints"].numpy())
            state["action"] = torch.from_numpy(command.action)
            state = env.step(state)
            lifted += state["next", "reward"].sum().item()
            state = step_mdp(state)
    assert lifted >= 4  # of six


def ball(centre=(0.5, 0.0, 0.04), n=400):
    points = np.random.default_rng(0).normal(size=(n, 3))
    return 0.03 * points / np.linalg.norm(points, axis=1, keepdims=True) + centre


@pytest.mark.parametrize("frame", ["ee", "camera", "base"])
def test_clouds_of_any_frame_give_one_answer(frame):
    hand = forward_kinematics(READY_POSTURE[None])[0]
    T_ee_camera = np.eye(4)
    T_ee_camera[:3, 3] = (0.05, 0.01, 0.02)
    to = {"base": np.eye(4), "ee": np.linalg.inv(hand), "camera": np.linalg.inv(hand @ T_ee_camera)}[frame]
    agent = GraspAgent(policy(), T_ee_camera=T_ee_camera)
    command = agent.act(points=ball() @ to[:3, :3].T + to[:3, 3], frame=frame, joints=READY_POSTURE)
    there = GraspAgent(policy()).act(points=ball(), frame="base", joints=READY_POSTURE, T_base_ee=hand)
    assert np.abs(command.action - there.action).max() < 1e-4
    assert command.goal.shape == (4, 4) and np.linalg.norm(command.goal[:3, 3] - (0.5, 0, 0.04)) < 0.25
    assert command.action.shape == (6,) and not command.close and command.num_points == 256


def test_each_arm_has_an_episode_of_its_own():
    agent = GraspAgent(policy(), num_arms=2)
    twice = {"points": [ball(), ball()], "frame": "base", "joints": np.stack([READY_POSTURE] * 2)}
    for _ in range(3):
        agent.act(**twice)
    agent.reset([1])
    command = agent.act(**twice)
    alone = GraspAgent(policy())
    for _ in range(4):
        last = alone.act(points=ball(), frame="base", joints=READY_POSTURE)
    assert np.allclose(command.action[0], last.action)
    assert not np.allclose(command.action[0], command.action[1])


def test_an_episode_ends_with_closed_fingers_and_asks_for_a_reset():
    agent = GraspAgent(policy())
    closed = [
        agent.act(points=ball(), frame="base", joints=READY_POSTURE).close for _ in range(agent.horizon)
    ]
    assert closed == [False] * (agent.horizon - 1) + [True]
    with pytest.raises(ConfigError, match="call reset"):
        agent.act(points=ball(), frame="base", joints=READY_POSTURE)
    agent.reset()
    assert not agent.act(points=ball(), frame="base", joints=READY_POSTURE).close


def test_the_table_s_height_lifts_what_would_go_through_it():
    hand = forward_kinematics(READY_POSTURE[None])[0]
    hand[2, 3] = 0.115  # fingers 2 mm above the table
    high = hand.copy()
    high[2, 3] += 0.3
    low = GraspAgent(policy()).act(
        points=ball((0.3, 0, 0.0)), frame="base", joints=READY_POSTURE, T_base_ee=hand
    )
    raised = GraspAgent(policy(), table_height=0.3).act(
        points=ball((0.3, 0, 0.3)), frame="base", joints=READY_POSTURE, T_base_ee=high
    )
    assert np.allclose(low.action, raised.action, atol=1e-4)
    assert np.allclose(low.T_base_ee[:3, 3] + (0, 0, 0.3), raised.T_base_ee[:3, 3], atol=1e-4)


def picture(seen=True):
    depth, mask = np.full((112, 112), 0.4, dtype=np.float32), np.zeros((112, 112), dtype=np.uint8)
    mask[50:60, 50:60] = 255 * seen
    return depth, mask


BAD = {
    "no point of the target has been seen yet": lambda d, m: (d, 0 * m, 0.0),
    "mask of 56 x 112 pixels": lambda d, m: (d, m[:, ::2], 0.0),
    "depth of 100 x 112 pixels": lambda d, m: (d[:, :100], m, 0.0),
    "depth has no return at any pixel": lambda d, m: (0 * d, m, 0.0),
    "no return at the target's pixels": lambda d, m: (np.where(m, np.nan, d), m, 0.0),
    "depth has no return at any pixel ": lambda d, m: (np.nan * d, m, 0.0),
    "the picture is 0.90 s old": lambda d, m: (d, m, 0.9),
}


@pytest.mark.parametrize("told", BAD)
def test_a_picture_that_cannot_be_used_is_answered_as_the_caller_chose(told):
    depth, mask, age = BAD[told](*picture())
    see = {"T_ee_camera": np.eye(4), "intrinsics": CAMERA}
    agent = GraspAgent(policy(), **see)
    command = agent.act(depth, mask, joints=READY_POSTURE, age=age)
    assert told.strip() in command.problem and not command.close
    assert np.array_equal(command.T_base_ee, forward_kinematics(READY_POSTURE[None])[0])
    assert not command.action.any() and np.isinf(command.age) and np.isnan(command.goal).all()
    with pytest.raises(PictureError, match=told.strip()):
        GraspAgent(policy(), on_problem="raise", **see).act(depth, mask, joints=READY_POSTURE, age=age)


def test_looking_again_goes_back_to_where_the_target_was_seen():
    agent = GraspAgent(policy(), T_ee_camera=np.eye(4), intrinsics=CAMERA, on_problem="look")
    agent.act(*picture(), joints=READY_POSTURE, age=0.1)
    elsewhere = READY_POSTURE + 0.1
    command = agent.act(np.zeros((112, 112)), picture()[1], joints=elsewhere)
    assert command.problem == "depth has no return at any pixel"
    assert np.allclose(command.T_base_ee, forward_kinematics(READY_POSTURE[None])[0])
    assert command.age == pytest.approx(0.25)


def test_the_target_may_leave_the_picture_once_it_has_been_seen():
    agent = GraspAgent(policy(), T_ee_camera=np.eye(4), intrinsics=CAMERA)
    agent.act(*picture(), joints=READY_POSTURE)
    command = agent.act(*picture(seen=False), joints=READY_POSTURE)
    assert command.problem is None and command.age == pytest.approx(0.15) and command.num_points > 0


def turned(pose):
    pose = np.array(pose)
    pose[0, 0] = 2.0
    return pose


WRONG = {
    "joints and T_base_ee are both missing": {},
    "joints of shape": {"joints": np.zeros(6)},
    "joints has NaN": {"joints": np.full(7, np.nan)},
    "T_base_ee is no rigid pose": {"joints": READY_POSTURE, "T_base_ee": turned(np.eye(4))},
    "T_base_ee of shape": {"T_base_ee": np.eye(3)},
    "wrist_angle|joints": {"T_base_ee": np.eye(4)},
    "age=-1": {"joints": READY_POSTURE, "age": -1.0},
    "depth and mask belong together": {"joints": READY_POSTURE, "mask": None},
    "depth of type uint8": {"joints": READY_POSTURE, "depth": np.ones((112, 112), dtype=np.uint8)},
    "depth of shape": {"joints": READY_POSTURE, "depth": np.ones((112, 112, 3))},
}


@pytest.mark.parametrize("told", WRONG)
def test_a_wrong_call_gets_one_clear_message(told):
    depth, mask = picture()
    agent = GraspAgent(policy(), T_ee_camera=np.eye(4), intrinsics=CAMERA)
    with pytest.raises(ConfigError, match=told):
        agent.act(**{"depth": depth, "mask": mask} | WRONG[told])
    # Nothing was lost: the next call is the first of the episode.
    assert not agent.act(depth, mask, joints=READY_POSTURE).close and agent._arms[0].steps == 1


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"policy": "nobody"}, "nobody"),
        ({"on_problem": "panic"}, "on_problem"),
        ({"T_ee_camera": np.eye(4), "T_base_camera": np.eye(4)}, "both given"),
        ({"T_ee_camera": np.zeros((4, 4))}, "T_ee_camera is no rigid pose"),
        ({"num_arms": 0}, "num_arms"),
        ({"intrinsics": CAMERA, "thin": 0}, "thin"),
        ({"max_age": -1.0}, "max_age"),
    ],
)
def test_an_impossible_agent_is_refused(options, told):
    with pytest.raises(ConfigError, match=told):
        GraspAgent(**{"policy": policy()} | options)


def test_it_acts_without_a_simulator():
    code = (
        "import numpy as np, sys; sys.modules['mujoco'] = None;"  # TorchRL loads it where it is installed
        "from torchgrasp import GraspAgent;"
        "agent = GraspAgent(); points = np.random.rand(300, 3) * 0.05 + [0.5, 0, 0];"
        "q = np.array([0, -0.785, 0, -2.356, 0, 1.571, 0.785]);"
        "assert agent.act(points=points, frame='base', joints=q).problem is None;"
        "print('sapien' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
