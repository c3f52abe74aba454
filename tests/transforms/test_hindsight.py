"""Goals from the pose reached (Sec. 6.1)."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, TransformedEnv, check_env_specs

from torchgrasp.data import CompactTransitions, MixtureReplayBuffer
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose, goal_to_pose
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import HindsightGoal, RandomMirror

HORIZON = 12
AT_THE_GOAL = [0, 0, 0, 0, 0, 0, 1]


def make_env(num_envs: int) -> GraspEnv:
    torch.set_num_threads(1)
    objects = ProceduralObjects("train", num_objects=2, num_grasps=100)
    camera = RaycastCamera(CameraIntrinsics(4, 4))
    return GraspEnv(num_envs, objects=objects, camera=camera, horizon=HORIZON, seed=0)


@pytest.fixture(scope="module")
def grasps() -> TensorDict:
    """(3, HORIZON) steps of the expert in the real environment; the last world's hand stands still."""
    env = make_env(3)
    expert = ExpertPolicy(env.objects, horizon=HORIZON)

    def act(td):
        td = expert(td)
        td["action"][2] = 0.0
        return td

    return env.rollout(HORIZON, act, break_when_any_done=False, break_when_all_done=True)


def make_steps() -> TensorDict:
    """(2, 5) steps: a success of 2, a failure of 2, a cut step; then a success of 4 and a cut step."""
    done = torch.tensor([[0, 1, 0, 1, 0], [0, 0, 0, 1, 0]]).bool()
    success = torch.tensor([[0, 1, 0, 0, 0], [0, 0, 0, 1, 0]]).float()
    generator = torch.Generator().manual_seed(0)
    moves = action_to_pose(0.3 * torch.randn(2, 6, 6, generator=generator))
    outcome = {"reward": success[..., None], "done": done[..., None], "terminated": done[..., None]}
    points = torch.zeros(2, 6, 4, 3)
    states = {"T_base_ee": moves, "points": points, "time_left": torch.rand(2, 6, 1)}
    root = {key: value[:, :-1] for key, value in states.items()}
    following = {key: value[:, 1:] for key, value in states.items()}
    return TensorDict({**root, "action": torch.zeros(2, 5, 6), "next": {**following, **outcome}}, [2, 5])


def test_goals_of_a_real_grasp_all_lead_to_the_pose_in_which_the_hand_closed(grasps):
    success = grasps["next", "reward"][:, -1, 0] > 0
    assert success.tolist() == [True, True, False]
    steps = HindsightGoal()(grasps.clone())
    reached = steps["T_base_ee"] @ goal_to_pose(steps["goal"])
    closed = grasps["next", "T_base_ee"][:, -1:]
    assert torch.allclose(reached[:2], closed[:2].expand(2, HORIZON, 4, 4), atol=1e-5)
    # Before the lift: the hand is at the height of the object, not 8 cm above it.
    lowest = grasps["T_base_ee"][:2, :, 2, 3].amin(dim=1)
    assert (closed[:2, 0, 2, 3] - lowest < 0.01).all()
    assert steps["has_goal"].squeeze(-1).all(dim=1).tolist() == [True, True, False]
    assert torch.equal(steps["next", "reward"], grasps["next", "reward"])


def test_the_pose_reached_lies_near_the_grasp_that_the_expert_aimed_at(grasps):
    goals = HindsightGoal()(grasps.clone())["goal"][:2, 0, :3]
    assert (goals - grasps["goal"][:2, 0, :3]).norm(dim=-1).max() < 0.02


def test_only_steps_of_episodes_that_succeeded_have_goals():
    steps = HindsightGoal()(make_steps())
    assert steps["has_goal"].squeeze(-1).tolist() == [
        [True, True, False, False, False],
        [True, True, True, True, False],
    ]
    without = steps["goal"][~steps["has_goal"].squeeze(-1)]
    assert without.tolist() == [[0.0] * 7] * 4
    reached = steps["T_base_ee"] @ goal_to_pose(steps["goal"])
    assert torch.allclose(reached[0, :2], steps["next", "T_base_ee"][0, 1].expand(2, 4, 4), atol=1e-5)
    assert torch.allclose(reached[1, :4], steps["next", "T_base_ee"][1, 3].expand(4, 4, 4), atol=1e-5)


def test_a_trajectory_that_was_cut_takes_no_goal_from_the_next_one():
    steps = make_steps()[1]
    steps["next", "done"] = (torch.arange(5) == 4)[:, None]
    steps["next", "reward"] = steps["next", "done"].float()
    steps["collector", "traj_ids"] = torch.tensor([0, 0, 1, 1, 1])
    steps = HindsightGoal()(steps)
    assert steps["has_goal"].squeeze(-1).int().tolist() == [0, 0, 1, 1, 1]
    assert steps["next", "has_goal"].squeeze(-1).int().tolist() == [0, 0, 1, 1, 1]
    assert not steps["goal"][:2].any()


def test_no_goal_is_what_the_expert_writes_where_it_has_none(grasps):
    without = ~grasps["has_goal"].squeeze(-1)
    steps = HindsightGoal()(make_steps())
    codec = CompactTransitions(gripper_points=False)
    rows = codec.encode(make_steps())
    for goals in (grasps["goal"][without], steps["goal"][~steps["has_goal"].squeeze(-1)], rows["goal"]):
        assert not goals.any()


def test_a_step_alone_is_refused():
    with pytest.raises(ConfigError, match=r"\(\*, T\), time last"):
        HindsightGoal()(make_steps()[0, 0])


def test_the_next_state_has_the_same_goal_in_its_own_frame():
    steps = HindsightGoal()(make_steps())
    assert torch.allclose(steps["next", "goal"][1, :3], steps["goal"][1, 1:4], atol=1e-5)
    # When the hand closes it is where it goes.
    assert torch.allclose(steps["next", "goal"][1, 3], torch.tensor(AT_THE_GOAL).float(), atol=1e-6)


def test_goals_that_were_there_go_or_are_kept():
    steps = make_steps()
    steps["goal"], steps["has_goal"] = torch.full((2, 5, 7), 0.5), torch.zeros(2, 5, 1, dtype=torch.bool)
    steps["has_goal"][0, 1:3] = True
    gone, kept = HindsightGoal()(steps.clone()), HindsightGoal(keep=True)(steps.clone())
    assert gone["has_goal"][0].squeeze(-1).tolist() == [True, True, False, False, False]
    assert kept["has_goal"][0].squeeze(-1).tolist() == [True, True, True, False, False]
    assert (kept["goal"][0, 1:3] == 0.5).all() and (gone["goal"][0, 1:3] != 0.5).all()
    assert torch.equal(kept["goal"][0, 0], gone["goal"][0, 0])


def test_in_a_mixture_buffer_trajectories_are_relabelled_before_they_are_compressed():
    steps, codec = make_steps(), CompactTransitions(gripper_points=False, state_keys=("time_left", "goal"))
    sizes = {"capacities": {"online": 50}, "shares": {"online": 1.0}, "batch_size": 200}
    buffer = MixtureReplayBuffer(**sizes, codec=codec, transform=HindsightGoal())
    buffer.extend(steps)
    expected = HindsightGoal()(steps.clone()).reshape(-1)
    batch = buffer.sample()
    assert not {"T_base_ee", ("next", "T_base_ee")} & set(batch.keys(True))
    for row in batch.unbind(0):
        (step,) = [each for each in expected.unbind(0) if each["time_left"] == row["time_left"]]
        assert torch.equal(row["goal"], step["goal"]) and torch.equal(row["has_goal"], step["has_goal"])
        assert torch.equal(row["next", "goal"], step["next", "goal"]) or row["next", "terminated"]
    # What was handed over is as it was.
    assert steps.get("goal", None) is None


def test_in_an_ordinary_buffer_samples_stay_as_they_were_stored():
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(10), batch_size=64, transform=HindsightGoal())
    buffer.extend(make_steps()[1])
    stored, batch = buffer.storage[:], buffer.sample()
    assert stored.get("T_base_ee", None) is None
    assert torch.equal(batch["goal"], stored["goal"][batch["index"]])


def test_in_an_environment_nothing_changes():
    env = TransformedEnv(make_env(1), Compose(HindsightGoal()))
    check_env_specs(env)
    step = env.rand_step(env.reset())
    again = env.rand_step(step)  # carries the "next" of the step before
    assert {"goal", "T_base_ee"} & set(again.keys()) == {"T_base_ee"}


def test_steps_without_poses_are_refused():
    with pytest.raises(ConfigError, match="T_base_ee"):
        HindsightGoal().inv(make_steps().exclude(("next", "T_base_ee")))


def test_a_mirrored_batch_mirrors_the_next_goal_too():
    goal = torch.tensor([0.1, 0.2, 0.3, 0.5, 0.5, 0.5, 0.5]).expand(64, 7)
    points = torch.ones(64, 5, 3)
    batch = RandomMirror()(TensorDict({"points": points, "goal": goal, "next": {"goal": goal}}, [64]))
    assert torch.equal(batch["goal"], batch["next", "goal"])
    assert len(batch["goal"].unique(dim=0)) == 4


def test_actions_of_successful_episodes_become_labels_but_for_disturbed_steps():
    steps = make_steps()
    steps["action"] = torch.rand(2, 5, 6)
    steps["perturbed"] = torch.zeros(2, 5, 1, dtype=torch.bool)
    steps["perturbed"][1, 2] = True
    out = HindsightGoal(imitate=True)(steps.clone())
    assert out["has_expert"].squeeze(-1).tolist() == [
        [True, True, False, False, False],
        [True, True, False, True, False],
    ]
    assert torch.equal(out["expert_action"], steps["action"])
    assert HindsightGoal()(steps.clone()).get("has_expert", None) is None


def test_labels_that_are_known_stay_on_demand():
    steps = make_steps()
    steps["action"], steps["expert_action"] = torch.ones(2, 5, 6), torch.full((2, 5, 6), 7.0)
    steps["has_expert"] = torch.zeros(2, 5, 1, dtype=torch.bool)
    steps["has_expert"][0] = True
    kept = HindsightGoal(keep=True, imitate=True)(steps.clone())
    assert kept["has_expert"][0].all() and (kept["expert_action"][0] == 7).all()
    assert kept["has_expert"][1, :4].all() and (kept["expert_action"][1] == 1).all()
    gone = HindsightGoal(imitate=True)(steps.clone())
    assert (gone["expert_action"] == 1).all()
    assert gone["has_expert"][0].squeeze(-1).tolist() == [True, True, False, False, False]
    goals_alone = HindsightGoal()(steps.clone())
    assert all(torch.equal(goals_alone[key], steps[key]) for key in ("expert_action", "has_expert"))


def test_imitating_needs_actions():
    steps = make_steps().exclude("action")
    with pytest.raises(ConfigError, match=r"needs \['action'\]"):
        HindsightGoal(imitate=True)(steps)
    assert HindsightGoal()(steps)["has_goal"].any()
