"""The task: actions, rewards, ends, worlds and their numbers."""

import math

import numpy as np
import pytest
import torch
from torchrl.envs import (
    Compose,
    RewardClipping,
    RewardScaling,
    RewardSum,
    SerialEnv,
    TransformedEnv,
    check_env_specs,
)

from torchgrasp.envs import GraspEnv, StartPoses
from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.geometry import action_to_pose, pose_to_action
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.sim.camera import T_EE_CAMERA

OBJECTS = ProceduralObjects("train", num_objects=4, num_grasps=100)
CAMERA = RaycastCamera(CameraIntrinsics(16, 16))


TO_THE_END = {"break_when_any_done": False, "break_when_all_done": True}


def make_env(num_envs: int = 2, **options) -> GraspEnv:
    torch.set_num_threads(1)
    options = {"objects": OBJECTS, "camera": CAMERA, "horizon": 5, "seed": 0} | options
    return GraspEnv(num_envs, **options)


def play(env: GraspEnv, actions: torch.Tensor):
    """A rollout of given actions (N, T, 6)."""
    queue = iter(actions.unbind(1))
    return env.rollout(actions.shape[1], lambda td: td.set("action", next(queue)), **TO_THE_END)


def test_an_action_moves_the_hand_by_that_relative_pose():
    env = make_env(4, horizon=20)
    state = env.reset()
    action = torch.tensor([0.005, -0.01, 0.02, 0.03, -0.02, 0.05]).expand(4, 6)
    after = env.step(state.set("action", action))["next"]
    wanted = state["T_base_ee"] @ action_to_pose(action)
    assert torch.allclose(after["T_base_ee"][:, :3, 3], wanted[:, :3, 3], atol=1.5e-3)
    assert torch.allclose(after["T_base_ee"][:, :3, :3], wanted[:, :3, :3], atol=1e-2)


def test_actions_beyond_the_bounds_count_as_the_bounds():
    bound = torch.tensor([0.06] * 3 + [math.pi / 6] * 3)
    env = make_env()
    assert torch.allclose(env.action_spec.space.high, bound.expand(2, 6))
    assert torch.allclose(env.action_spec.space.low, -bound.expand(2, 6))
    steps = [play(make_env(), factor * bound.expand(2, 2, 6)) for factor in (1.001, 100.0)]
    assert torch.equal(steps[0]["next", "joints"], steps[1]["next", "joints"])


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_actions_that_are_no_numbers_are_refused(value):
    env = make_env()
    action = torch.zeros(2, 6)
    action[1, 3] = value
    with pytest.raises(TorchgraspError, match="NaN"):
        env.step(env.reset().set("action", action))


def test_the_policys_action_is_not_written_to():
    env = make_env()
    action = torch.full((2, 6), 9.0)
    env.step(env.reset().set("action", action))
    assert torch.equal(action, torch.full((2, 6), 9.0))


def test_time_runs_down_and_the_episode_ends_at_the_horizon():
    steps = make_env(horizon=4).rollout(10, **TO_THE_END)
    assert steps.shape == (2, 4)
    assert steps["time_left"][0, :, 0].tolist() == [1.0, 0.75, 0.5, 0.25]
    assert steps["next", "time_left"][0, -1, 0] == 0.0


def test_the_reward_comes_with_the_last_step_for_objects_that_rose():
    env = make_env(6, horizon=20)
    steps = env.rollout(20, ExpertPolicy(OBJECTS, horizon=20), **TO_THE_END)
    reward = steps["next", "reward"][..., 0]
    assert not reward[:, :-1].any() and reward[:, -1].sum() >= 5
    # The last state is seen before the fingers close; asked once more, the worlds tell what became of it.
    assert torch.allclose(steps["next", "joints"][:, -1, 7:], torch.tensor(0.04), atol=1e-3)
    over = env.step(steps["next"][:, -1].clone().set("action", torch.zeros(6, 6)))["next"]
    rise = (over["T_base_object"] - steps["next", "T_base_object"][:, -1])[:, 2, 3]
    assert torch.equal(reward[:, -1] == 1.0, rise >= 0.08)
    assert rise.median() == pytest.approx(0.15, abs=0.03)  # the hand rises by 15 cm


def test_a_hand_that_grasps_nothing_earns_nothing():
    assert not play(make_env(6), torch.zeros(6, 5, 6))["next", "reward"].any()


def test_an_object_that_falls_off_the_table_ends_the_episode_unrewarded():
    # Beside the rim at y = 0.65, in the air.
    beside = StartPoses(table_x=(0.30, 0.40), table_y=(0.72, 0.74))
    steps = play(make_env(1, objects=OBJECTS[:1], start=beside, horizon=8), torch.zeros(1, 8, 6))
    assert steps.shape[1] < 8
    assert steps["next", "terminated"][0, -1] and not steps["next", "reward"].any()
    heights = steps["next", "T_base_object"][0, :, 2, 3]
    assert heights[-1] < -0.1 and torch.all(heights[:-1] >= -0.1)


def test_an_ended_world_waits_for_its_reset():
    env = make_env(horizon=1)
    state = env.step(env.reset().set("action", torch.zeros(2, 6)))["next"]
    states = [env.step(state.clone().set("action", torch.full((2, 6), a)))["next"] for a in (0.0, 0.05)]
    assert torch.equal(states[0]["joints"], states[1]["joints"])
    for after in states:
        assert not after["reward"].any() and after["done"].all() and not after["time_left"].any()


@pytest.mark.parametrize("first_world", [0, 5])
def test_a_world_depends_on_seed_and_number_alone(first_world):
    torch.manual_seed(1)
    actions = torch.empty(4, 10, 6).uniform_(-0.05, 0.05)
    actions[0] *= 10  # one of them knocks into things

    def episodes(env, rows):
        state, out = env.reset(), []
        for action in actions[rows].unbind(1):
            step, state = env.step_and_maybe_reset(state.set("action", action))
            out.append(step)
        return torch.stack(out, dim=1)

    together = episodes(make_env(4, seed=2, first_world=first_world), slice(0, 4))
    for row in range(4):
        alone = episodes(make_env(1, seed=2, first_world=first_world + row), slice(row, row + 1))
        for key in alone.keys(True, True):
            assert torch.equal(alone.get(key)[0], together.get(key)[row]), (row, key)
    assert together["world"][:, 0, 0].tolist() == list(range(first_world, first_world + 4))
    assert len(set(together["T_base_object"][:, 0, 0, 3].tolist())) == 4


def test_a_run_goes_on_from_the_episodes_it_had_reached():
    env = make_env()
    states = [env.reset() for _ in range(4)]
    assert env.episodes_started == [3, 3]
    resumed = make_env()
    resumed.start_episodes_at([3, 2])
    state = resumed.reset()
    assert state["episode"].flatten().tolist() == [3, 2]
    assert torch.equal(state["T_base_object"][0], states[3]["T_base_object"][0])
    assert torch.equal(state["T_base_object"][1], states[2]["T_base_object"][1])
    assert torch.equal(state["joints"][0], states[3]["joints"][0])


def test_the_scene_of_an_episode_can_be_asked_for_beforehand():
    env = make_env(first_world=3, seed=9)
    scene = env.scene(1, 0)
    state = env.reset()
    assert state["object_id"][1].item() == scene.object_id
    assert state["T_base_object"][1].numpy() == pytest.approx(scene.T_base_object, abs=1e-6)
    assert state["joints"][1, :7].numpy() == pytest.approx(scene.q, abs=1e-6)


def test_observed_poses_belong_together():
    steps = make_env(3).rollout(3)
    T_base_ee, T_base_camera = steps["T_base_ee"], steps["T_base_camera"]
    offset = torch.from_numpy(T_EE_CAMERA).float()
    assert torch.allclose(T_base_ee @ offset, T_base_camera, atol=1e-6)
    moved = torch.linalg.solve(steps["T_base_ee"], steps["next", "T_base_ee"])
    assert pose_to_action(moved).abs().max() < math.pi / 3


def test_the_target_is_in_the_picture_at_the_start():
    state = make_env(8).reset()
    assert (state["camera", "mask"].flatten(1).sum(-1) > 0).float().mean() > 0.8


@pytest.mark.parametrize(
    "options",
    [
        {"num_envs": 0},
        {"num_envs": 1.5},
        {"horizon": 0},
        {"horizon": -3},
        {"target_motion": "x"},
        {"objects": []},
    ],
)
def test_bad_options_are_refused(options):
    with pytest.raises(ConfigError):
        make_env(**options)


def test_seeds_reach_every_world():
    env = make_env(3)
    starts = []
    for seed in (0, 1):
        env.set_seed(seed, static_seed=True)
        starts.append(env.reset()["T_base_object"])
    assert not np.isclose(starts[0][:, 0, 3], starts[1][:, 0, 3]).any()


def test_environments_without_a_seed_differ_and_a_seed_repeats_them():
    first, second = (make_env(seed=None).reset() for _ in range(2))
    assert not torch.equal(first["T_base_object"], second["T_base_object"])
    envs = SerialEnv(2, [make_env, make_env])
    both = []
    for _ in range(2):
        envs.set_seed(7)
        both.append(envs.reset()["T_base_object"])
    assert torch.equal(*both) and not torch.equal(both[0][0], both[0][1])


def test_torchrls_reward_transforms_take_the_reward():
    env = TransformedEnv(make_env(), Compose(RewardScaling(0.5, 2.0), RewardSum(), RewardClipping(-1.0, 1.0)))
    check_env_specs(env)
    steps = env.rollout(3)
    assert steps["next", "reward"].unique().tolist() == [0.5]
    assert steps["next", "episode_reward"][0, :, 0].tolist() == [0.5, 1.0, 1.5]


def test_the_specs_hold_in_mujoco():
    env = make_env(2, engine="mujoco", horizon=2)
    assert env.worlds.engine.name == "mujoco"
    check_env_specs(env, break_when_any_done="both")


def test_an_engine_that_is_unknown_is_refused():
    with pytest.raises(ConfigError, match="engine='bullet' is unknown: give sapien or mujoco"):
        make_env(engine="bullet")


def test_both_engines_have_the_same_scenes_and_move_on_by_themselves():
    one, other = make_env(3, engine="sapien"), make_env(3, engine="mujoco")
    first, second = one.reset(), other.reset()
    for key in ("T_base_object", "T_base_ee", ("camera", "depth"), ("camera", "mask")):
        torch.testing.assert_close(first[key], second[key], atol=1e-5, rtol=1e-5)
    actions = torch.tensor([0.02, 0.0, 0.02, 0.0, 0.1, 0.0]).expand(3, 2, 6)
    one, other = play(one, actions), play(other, actions)
    apart = one["next", "T_base_ee"] - other["next", "T_base_ee"]
    assert 0.0 < apart.abs().max() < 5e-3


def test_an_episode_in_mujoco_depends_on_seed_and_number_alone():
    actions = torch.rand(4, 5, 6, generator=torch.Generator().manual_seed(0)) * 0.1 - 0.05
    among = play(make_env(4, engine="mujoco"), actions)
    used = make_env(1, engine="mujoco", first_world=2)
    used.rollout(5)
    used.set_seed(0)
    for env in (used, make_env(1, engine="mujoco", first_world=2)):
        alone = play(env, actions[2:3])
        for key in ("joints", "T_base_object", ("camera", "depth"), "reward"):
            assert torch.equal(alone["next", key][0], among["next", key][2])
