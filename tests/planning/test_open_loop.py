"""One planned trajectory an episode: carried out to its end, without another look."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import FunnelPlanner, OpenLoopPolicy, PlanStatus, PoseNoise, TrajectoryPlanner
from torchgrasp.sim import CameraIntrinsics, RaycastCamera

OBJECTS = ProceduralObjects("train", num_objects=8, num_grasps=200)
HORIZON, STEPS = 30, 25


def make_env(num_envs: int, **options) -> GraspEnv:
    torch.set_num_threads(1)
    options = {"objects": OBJECTS, "horizon": HORIZON, "seed": 0, **options}
    return GraspEnv(num_envs, camera=RaycastCamera(CameraIntrinsics(4, 4)), **options)


def make_policy(**options) -> OpenLoopPolicy:
    return OpenLoopPolicy(OBJECTS, horizon=HORIZON, **options)


def roll_out(env: GraspEnv, policy) -> TensorDict:
    return env.rollout(HORIZON, policy, break_when_any_done=False, break_when_all_done=True)


class Recorder(TrajectoryPlanner):
    """The real planner, which keeps what it was asked and what it answered."""

    def plan(self, *question, **options):
        answer = super().plan(*question, **options)
        self.__dict__.setdefault("asked", []).append((question, answer))
        return answer


@pytest.fixture(scope="module")
def planner() -> Recorder:
    return Recorder(arrive=1.0)


@pytest.fixture(scope="module")
def steps(planner) -> TensorDict:
    return roll_out(make_env(8), make_policy(planner=planner))


def test_from_true_poses_nearly_every_object_is_lifted(steps):
    assert steps["next", "reward"][:, -1].sum() >= 7
    assert torch.all(steps["plan_status"] == PlanStatus.OK.number)


def test_it_plans_once_an_episode_over_its_own_steps(steps, planner):
    assert len(planner.asked) == 8
    for (_, T_base_object, q, steps_left, horizon), plan in planner.asked:
        assert (steps_left, horizon) == (STEPS, STEPS) and len(plan.T_base_ee) == STEPS + 1
        assert any(np.allclose(T_base_object, pose) for pose in steps["T_base_object"][:, 0].numpy())
        assert any(np.allclose(q, joints[:7]) for joints in steps["joints"][:, 0].numpy())


def test_the_hand_passes_the_planned_poses_in_their_time_and_stays_at_the_last(steps, planner):
    for world in range(8):
        path = planner.asked[world][1].T_base_ee
        hand = steps["next", "T_base_ee"][world].numpy()
        due = path[np.minimum(np.arange(1, HORIZON + 1), STEPS)]
        assert np.linalg.norm(hand[:, :3, 3] - due[:, :3, 3], axis=-1).max() < 2e-3
        assert np.linalg.norm(hand[STEPS + 1 :, :3, 3] - path[-1, :3, 3], axis=-1).max() < 5e-4


def test_actions_are_legal(steps):
    high = make_env(1).action_spec.space.high[0]
    assert torch.all(steps["action"].abs() <= high + 1e-6)


def test_it_does_not_look_again(steps):
    policy, blind = make_policy(), make_policy()
    for t in (0, 1, 10, 27):
        state = steps[:, t].clone()
        lost = state.clone()
        if t:
            lost["T_base_object"][:, :3, 3] += 0.2
        assert torch.equal(policy(state)["action"], blind(lost)["action"])


def test_a_pushed_hand_is_led_back_to_the_path(steps):
    policy = make_policy()
    policy(steps[:, 0].clone())
    state = steps[:, 10].clone()
    state["T_base_ee"][:, :3, 3] += torch.tensor([0.01, 0.0, 0.0])
    hand = state["T_base_ee"] @ action_to_pose(policy(state)["action"])
    assert torch.allclose(hand[:, :3, 3], steps["next", "T_base_ee"][:, 10, :3, 3], atol=2e-3)


def test_a_new_episode_is_planned_for_anew_whatever_its_number(steps):
    policy = make_policy()
    first = policy(steps[:4, 0].clone())["action"]
    # Another seed's episode: the same world, number and time, other poses.
    other = make_env(4, seed=7).reset()
    assert torch.equal(policy(other.clone())["action"], make_policy()(other.clone())["action"])
    policy(steps[:4, 5].clone())
    assert torch.equal(policy(steps[:4, 0].clone())["action"], first)


def test_first_asked_in_the_middle_it_plans_over_the_steps_that_are_left(steps):
    planner = Recorder()
    labels = make_policy(planner=planner)(steps[:, 12].clone())
    assert all(question[3:] == (HORIZON - 12,) * 2 for question, _ in planner.asked)
    assert labels["action"].isfinite().all()


@pytest.mark.parametrize("action_space", ["joint_delta", "joint_velocity"])
def test_in_joint_spaces_the_hand_ends_in_the_grasp_as_well(action_space):
    env, planner = make_env(3, action_space=action_space), Recorder()
    steps = roll_out(env, make_policy(planner=planner, action_space=env.actions))
    assert steps["action"].shape == (3, HORIZON, 7)
    for world, (_, plan) in enumerate(planner.asked):
        end = steps["next", "T_base_ee"][world, -1, :3, 3].numpy()
        assert end == pytest.approx(plan.T_base_goal[:3, 3], abs=5e-3)


def test_any_batch_shape_is_welcome(steps):
    state = steps[:6, 0]
    flat = make_policy()(state.clone())
    grid = make_policy()(state.clone().reshape(2, 3))
    single = make_policy()(state[0].clone())
    for key in ("action", "plan_status"):
        assert torch.equal(grid[key].reshape(flat[key].shape), flat[key]), key
        assert torch.equal(single[key], flat[key][0]), key


def test_the_pose_told_is_one_draw_an_episode_and_belongs_to_it(steps):
    def told(states: TensorDict, seed: int = 0) -> dict:
        planner = Recorder()
        policy = make_policy(planner=planner, pose_noise=PoseNoise(), seed=seed)
        for t in (0, 1, 2):
            policy(states[:, t].clone())
        assert len(planner.asked) == len(states)
        return {int(w): q[1] for w, (q, _) in zip(states["world"][:, 0, 0], planner.asked, strict=True)}

    whole, part, other = told(steps), told(steps[5:]), told(steps, seed=1)
    for world in (5, 6, 7):
        assert np.array_equal(whole[world], part[world])
        assert not np.allclose(whole[world], other[world])
    offsets = [whole[w][:3, 3] - steps["T_base_object"][w, 0, :3, 3].numpy() for w in range(8)]
    assert len({tuple(offset) for offset in offsets}) == 8


@pytest.mark.parametrize("distribution", ["gaussian", "uniform"])
def test_errors_are_as_large_as_asked(distribution):
    rng = np.random.default_rng(0)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    noise = PoseNoise(translation=0.02, rotation=0.1, distribution=distribution)
    seen = np.array([noise.perceive(pose, rng) for _ in range(2000)])
    shift = seen[:, :3, 3]
    angle = Rotation.from_matrix(seen[:, :3, :3] @ pose[:3, :3].T).magnitude()
    # A uniform error's standard deviation is its bound over the root of three.
    share = 1.0 if distribution == "gaussian" else 3**-0.5
    assert shift.std(axis=0) == pytest.approx(0.02 * share, rel=0.06)
    assert np.sqrt((angle**2).mean()) == pytest.approx(0.1 * share, rel=0.06)
    assert np.abs(shift.mean(axis=0)).max() < 0.002
    if distribution == "uniform":
        assert np.abs(shift).max() <= 0.02 and angle.max() <= 0.1 + 1e-9


def test_without_an_error_the_pose_is_the_true_one():
    pose = np.eye(4)
    pose[:3, 3] = 0.5, 0.1, 0.05
    seen = PoseNoise(translation=0.0, rotation=0.0).perceive(pose, np.random.default_rng(0))
    assert seen == pytest.approx(pose, abs=1e-15)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: make_policy(steps=31), "^steps=31"),
        (lambda: make_policy(steps=0), "^steps=0"),
        (lambda: make_policy(steps=2.5), "^steps=2.5"),
        (lambda: make_policy(planner=FunnelPlanner(prove=False)), "prove=True"),
        (lambda: PoseNoise(translation=-0.01), "^translation=-0.01"),
        (lambda: PoseNoise(rotation=4.0), "^rotation=4.0"),
        (lambda: PoseNoise(distribution="cauchy"), "cauchy"),
    ],
)
def test_impossible_options_are_refused(make, told):
    with pytest.raises(ConfigError, match=told):
        make()
