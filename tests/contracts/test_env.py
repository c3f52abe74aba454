"""What every environment of the library keeps to, in TorchRL's terms."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, EnvBase, SerialEnv, StepCounter, TransformedEnv, check_env_specs
from torchrl.envs.utils import step_mdp

from torchgrasp.envs import GraspEnv
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AggregatePoints, AppendGripperPoints, DepthToPoints, SamplePoints

HORIZON = 4


def make_env(*, seed: int = 0) -> GraspEnv:
    torch.set_num_threads(1)
    objects = ProceduralObjects("train", num_objects=3, num_grasps=100)
    camera = RaycastCamera(CameraIntrinsics(16, 16))
    return GraspEnv(3, objects=objects, camera=camera, horizon=HORIZON, seed=seed)


def with_clouds(*, seed: int = 0) -> TransformedEnv:
    chain = [DepthToPoints(), AggregatePoints(max_points=500), SamplePoints(32), AppendGripperPoints()]
    return TransformedEnv(make_env(seed=seed), Compose(*chain))


def with_torchrls_transforms(*, seed: int = 0) -> TransformedEnv:
    return TransformedEnv(make_env(seed=seed), Compose(DepthToPoints(), StepCounter(max_steps=100)))


@pytest.fixture(params=[make_env, with_clouds, with_torchrls_transforms], ids=lambda make: make.__name__)
def make(request):
    return request.param


@pytest.fixture
def env(make) -> EnvBase:
    return make()


def actions(env: EnvBase, num_steps: int) -> list[torch.Tensor]:
    torch.manual_seed(0)
    return [env.action_spec.rand() for _ in range(num_steps)]


def act(env: EnvBase, tensordict: TensorDict, action: torch.Tensor) -> TensorDict:
    """One step; the state after it at the root."""
    return step_mdp(env.step(tensordict.set("action", action)), exclude_action=False)


def assert_same(a: TensorDict, b: TensorDict, *, rows=slice(None)) -> None:
    keys = set(a.keys(True, True))
    assert keys == set(b.keys(True, True))
    for key in keys:
        assert torch.equal(a.get(key)[rows], b.get(key)[rows]), key


def test_specs(env):
    check_env_specs(env, break_when_any_done="both")


def test_specs_under_serial_env(make):
    check_env_specs(SerialEnv(2, [partial(make, seed=0), partial(make, seed=1)]), break_when_any_done="both")


def test_batch_is_locked_and_leads_every_spec(env):
    assert env.batch_size == (3,) and env.batch_locked
    for spec in (env.observation_spec, env.full_action_spec, env.full_reward_spec, env.full_done_spec):
        for leaf in spec.values(True, True):
            assert leaf.shape[0] == 3


def test_same_seed_same_rollout(make):
    def rollout(env):
        torch.manual_seed(0)
        return env.rollout(HORIZON, break_when_any_done=False)

    first = rollout(make(seed=3))
    assert_same(first, rollout(make(seed=3)))
    env = make()
    rollout(env)  # a past leaves no trace
    env.set_seed(3, static_seed=True)
    assert_same(first, rollout(env))
    assert not torch.equal(first["joints"], rollout(make(seed=4))["joints"])


def test_partial_reset_leaves_the_other_worlds_alone(make):
    env, alone = make(), make()
    first, second = env.reset(), alone.reset()
    chosen = actions(env, HORIZON)
    for action in chosen[:2]:
        first, second = act(env, first, action), act(alone, second, action)
    mask = torch.tensor([[False], [True], [False]])
    mixed = env.reset(first.clone().set("_reset", mask)).exclude("_reset")
    assert mixed["time_left"].flatten().tolist() == [0.5, 1.0, 0.5]
    assert mixed["episode"].flatten().tolist() == [0, 1, 0]
    keys = [key for key in second.keys(True, True) if key in mixed.keys(True, True)]
    for action in chosen[2:]:
        assert_same(mixed.select(*keys), second.select(*keys), rows=[0, 2])
        mixed, second = act(env, mixed, action), act(alone, second, action)
    assert_same(mixed.select(*keys), second.select(*keys), rows=[0, 2])


def test_a_partial_reset_gives_what_a_full_one_gives(make):
    env, whole = make(), make()
    state = act(env, env.reset(), actions(env, 1)[0])
    mixed = env.reset(state.set("_reset", torch.tensor([[False], [True], [False]])))
    whole.reset()
    assert_same(whole.reset().exclude("action"), mixed.exclude("action", "_reset"), rows=[1])


def test_worlds_outside_the_step_mask_do_not_move(env):
    state = env.reset()
    before = state.clone()
    mask = torch.tensor([True, False, True])
    after = env.step(state.set("action", actions(env, 1)[0]).set("_step", mask))["next"]
    for key in ("joints", "T_base_object", "time_left", "T_base_ee", "episode"):
        assert torch.equal(after[key][1], before[key][1]), key
        assert key in ("episode", "T_base_object") or not torch.equal(after[key][0], before[key][0])


def test_clouds_of_worlds_outside_the_step_mask_do_not_change():
    env = with_clouds()
    state = env.reset()
    before = state.clone()
    mask = torch.tensor([True, False, True])
    after = env.step(state.set("action", actions(env, 1)[0]).set("_step", mask))["next"]
    assert torch.equal(after["points"][1], before["points"][1])
    assert torch.equal(after["num_points"][1], before["num_points"][1])


def test_what_was_returned_is_never_written_to_again(env):
    state = env.reset()
    kept = [(state, state.clone())]
    for action in actions(env, HORIZON):
        state = act(env, state.clone(), action)
        kept.append((state, state.clone()))
    env.reset()
    for returned, copy in kept:
        assert_same(returned, copy)


def test_the_end_is_terminal_never_truncated(env):
    steps = env.rollout(HORIZON + 5, break_when_any_done=False, break_when_all_done=True)
    assert steps.shape == (3, HORIZON)
    assert torch.equal(steps["next", "done"], steps["next", "terminated"])
    assert steps["next", "terminated"][:, -1].all() and not steps["next", "terminated"][:, :-1].any()
    assert not steps["next", "truncated"].any()


def test_resets_follow_ends_within_one_rollout(env):
    state = env.reset()
    numbers = []
    for action in actions(env, 2 * HORIZON + 1):
        numbers.append(state["episode"][:, 0].tolist())
        _, state = env.step_and_maybe_reset(state.set("action", action))
    first = numbers[0][0]
    assert [row[0] - first for row in numbers] == [0] * HORIZON + [1] * HORIZON + [2]


def test_resets_are_transformed_like_steps(env):
    state = env.reset()
    assert set(env.observation_spec.keys(True, True)) <= set(state.keys(True, True))
    env.observation_spec.assert_is_in(state.select(*env.observation_spec.keys(True, True)))
