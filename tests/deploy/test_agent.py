"""GraspAgent beside the environment that its policy was trained in, and what it says of bad input."""

import functools
import subprocess
import sys

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs.utils import step_mdp

import torchgrasp
from tests.deploy.pretrained import policy
from torchgrasp import keys
from torchgrasp.config.trained_policy import TrainedPolicy
from torchgrasp.config.trained_view import choose_transforms
from torchgrasp.deploy import GraspAgent
from torchgrasp.errors import ConfigError, PictureError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import RaycastCamera
from torchgrasp.sim.kinematics import READY_POSTURE, forward_kinematics

WORLDS = 3
CAMERA = CameraIntrinsics()


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
    "lie beyond far=2.0 m": lambda d, m: (1000 * d, m, 0.0),
    "no return at the target's pixels ": lambda d, m: (np.where(m, 0.02, d), m, 0.0),
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


def looking(**options):
    return GraspAgent(policy(), T_ee_camera=np.eye(4), intrinsics=CAMERA, on_problem="look", **options)


def test_looking_again_goes_back_to_where_the_target_was_seen_step_by_step():
    agent, blind = looking(), np.zeros((112, 112))
    agent.act(*picture(), joints=READY_POSTURE, age=0.1)
    hand = forward_kinematics(READY_POSTURE[None] + 0.2)[0]
    seen = forward_kinematics(READY_POSTURE[None])[0]
    ages = []
    for _ in range(8):
        command = agent.act(blind, picture()[1], joints=READY_POSTURE, T_base_ee=hand)
        assert command.problem == "depth has no return at any pixel"
        assert (np.abs(command.action) <= np.float32(ACTION_BOUND)).all()
        hand = command.T_base_ee
        ages.append(float(command.age))
    assert np.allclose(hand, seen, atol=1e-6) and ages[:2] == pytest.approx([0.25, 0.4])


@pytest.mark.parametrize("on_problem", ["hold", "look"])
def test_an_old_picture_never_moves_the_hand(on_problem):
    agent = GraspAgent(policy(), T_ee_camera=np.eye(4), intrinsics=CAMERA, on_problem=on_problem)
    agent.act(*picture(), joints=READY_POSTURE)
    elsewhere = READY_POSTURE + 0.1
    for age in (0.6, np.inf):
        command = agent.act(*picture(), joints=elsewhere, age=age)
        assert "s old" in command.problem and not command.action.any()
        assert np.array_equal(command.T_base_ee, forward_kinematics(elsewhere[None])[0])


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
    "depth cannot be read": {"joints": READY_POSTURE, "depth": [[1.0], [1.0, 2.0]]},
    "mask has values between 0 and 1": {"joints": READY_POSTURE, "mask": np.full((112, 112), 0.3)},
    "joint 4 cannot stand at 0.000 rad": {"joints": np.zeros(7)},
    "joint 2 cannot stand at 22.500 rad": {"joints": np.degrees(READY_POSTURE)},
    "age of shape": {"joints": READY_POSTURE, "age": [0.0, 0.1]},
    "age='now' cannot be read": {"joints": READY_POSTURE, "age": "now"},
    "age=nan": {"joints": READY_POSTURE, "age": np.nan},
    "no points beside them": {"joints": READY_POSTURE, "points": np.ones((5, 3))},
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
        ({"intrinsics": np.eye(3)}, "CameraIntrinsics.from_matrix"),
        ({"intrinsics": CAMERA, "thin": 0}, "thin"),
        ({"max_age": -1.0}, "max_age"),
    ],
)
def test_an_impossible_agent_is_refused(options, told):
    with pytest.raises(ConfigError, match=told):
        GraspAgent(**{"policy": policy()} | options)


@pytest.mark.parametrize("as_type", [np.float16, np.float64, torch.float16, torch.bfloat16, np.int16, ">u2"])
@pytest.mark.parametrize("as_mask", [bool, np.uint8, np.int64, np.float32, torch.bool])
def test_pictures_of_any_type_give_one_answer(as_type, as_mask):
    depth, mask = picture()
    given = as_type if isinstance(as_type, torch.dtype) else np.dtype(as_type)
    depth = np.full_like(depth, 0.5)  # no type rounds it
    plain = GraspAgent(policy(), T_ee_camera=np.eye(4), intrinsics=CAMERA)
    expected = plain.act(depth, mask, joints=READY_POSTURE)
    if isinstance(given, torch.dtype):
        depth = torch.from_numpy(depth).to(given).requires_grad_()
    else:
        depth = (depth * 1000 if given.kind in "iu" else depth).astype(given)
    mask = (
        torch.from_numpy(mask).to(as_mask) if isinstance(as_mask, torch.dtype) else (mask > 0).astype(as_mask)
    )
    agent = GraspAgent(policy(), T_ee_camera=torch.eye(4), intrinsics=CAMERA)
    command = agent.act(depth, mask, joints=torch.tensor(READY_POSTURE), age=torch.tensor(0.0))
    assert np.abs(command.action - expected.action).max() < 1e-5


class Told(torch.nn.Module):
    """A network that says what it was told to."""

    def __init__(self, action):
        super().__init__()
        self.action = torch.nn.Parameter(torch.tensor(action))

    def forward(self, points):
        return self.action.expand(len(points), -1)


def make_policy(action, **env):
    said = TensorDictModule(Told(action), ["points"], ["action"])
    config = {**policy().config, "env": {**policy().config["env"], **env}}
    return TrainedPolicy(said, config=config)


def test_actions_are_bounded_as_the_environment_bounds_them():
    agent = GraspAgent(make_policy([1.0, -1.0, 0.01, 2.0, -2.0, 0.1]))
    command = agent.act(points=ball(), frame="base", joints=READY_POSTURE)
    expected = np.float32([0.06, -0.06, 0.01, np.pi / 6, -np.pi / 6, 0.1])
    assert np.array_equal(command.action, expected) and np.isnan(command.goal).all()
    hand = forward_kinematics(READY_POSTURE[None])[0]
    assert np.linalg.norm((command.T_base_ee - hand)[:3, 3]) < 0.09


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_policy_that_gives_no_number_moves_nothing(bad):
    agent = GraspAgent(make_policy([0.0, 0.0, 0.0, 0.0, 0.0, bad]))
    with pytest.raises(ConfigError, match="action has NaN or infinity: do not move"):
        agent.act(points=ball(), frame="base", joints=READY_POSTURE)


def test_a_policy_of_another_action_space_is_refused():
    with pytest.raises(ConfigError, match="action_space=joint_delta"):
        GraspAgent(make_policy([0.0] * 7, action_space="joint_delta"))


def test_what_the_policy_does_not_read_need_not_be_told():
    agent = GraspAgent(make_policy([0.0] * 6))
    hand = forward_kinematics(READY_POSTURE[None])[0]
    assert agent.act(points=ball(), frame="base", T_base_ee=hand).problem is None
    with pytest.raises(ConfigError, match="needs joints"):
        GraspAgent(policy()).act(points=ball(), frame="base", T_base_ee=hand)


def test_the_transforms_are_those_of_training():
    kept = [made.__name__ for made, _ in choose_transforms(policy())]
    named = [node["_target_"].rpartition(".")[2] for node in policy().config["transforms"].values()]
    assert kept == named


def test_an_arm_whose_episode_is_over_waits_for_its_reset_beside_the_others():
    agent = GraspAgent(policy(), num_arms=2, on_problem="raise")
    twice = {"points": [ball(), ball()], "frame": "base", "joints": np.stack([READY_POSTURE] * 2)}
    agent.act(**twice)
    agent.reset([1])
    for _ in range(agent.horizon - 1):
        command = agent.act(**twice)
    assert command.close.tolist() == [True, False]
    command = agent.act(**twice)
    assert "call reset" in command.problems[0] and command.problems[1] is None
    assert command.close.tolist() == [False, True] and not command.action[0].any()
    with pytest.raises(ConfigError, match="call reset"):
        agent.act(**twice)
    agent.reset(np.array([0]))
    assert agent.act(**twice).problems[0] is None


@pytest.mark.parametrize("arms", [[2], [-1], [True, False], 0, [0.5], "all"])
def test_arms_that_are_not_there_are_not_reset(arms):
    with pytest.raises(ConfigError, match="arms="):
        GraspAgent(policy(), num_arms=2).reset(arms)


FAR = {
    "no point lies within": ball((500.0, 0.0, 40.0)),
    "points are all NaN": np.full((4, 3), np.nan),
    "no point of the target": np.zeros((0, 3)),
    "no point of the target ": [],
}


@pytest.mark.parametrize("told", FAR)
def test_a_cloud_without_a_target_holds(told):
    command = GraspAgent(policy()).act(points=FAR[told], frame="base", joints=READY_POSTURE)
    assert told.strip() in command.problem and not command.action.any()


def test_an_agent_leaves_the_policy_of_its_owner_where_it_is():
    mine = make_policy([0.0] * 6)
    agent = GraspAgent(mine, device="meta")
    assert agent.policy is not mine and {each.device.type for each in mine.parameters()} == {"cpu"}


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
