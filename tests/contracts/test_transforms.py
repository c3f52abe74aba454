"""What every transform of the library keeps to: in an environment, in a buffer, on a bare tensordict."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import pytest
import torch
from tensordict import TensorDict, unravel_key
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, SerialEnv, Transform, TransformedEnv, check_env_specs

import torchgrasp.transforms as library
from torchgrasp.envs import GraspEnv
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import (
    AggregatePoints,
    AppendGripperPoints,
    CameraImage,
    CameraPoseError,
    DelayObservation,
    DepthNoise,
    DepthToPoints,
    DropPoints,
    JitterPoints,
    RandomMirror,
    SamplePoints,
    TablePlane,
    WristAngle,
)

HORIZON = 3


@dataclass(frozen=True)
class Case:
    """A transform and those that it stands behind."""

    kind: type[Transform]
    options: dict
    behind: tuple[type[Transform], ...]
    needs_time: bool = False

    def make(self) -> Transform:
        return self.kind(**self.options)

    def before(self) -> list[Transform]:
        return [kind() for kind in self.behind]


# Those of observations; RandomMirror and HindsightGoal work on samples and trajectories: see their tests.
CASES = [
    Case(DepthToPoints, {}, ()),
    Case(AggregatePoints, {"max_points": 300}, (DepthToPoints,), needs_time=True),
    Case(SamplePoints, {"num_points": 24}, (DepthToPoints,)),
    Case(AppendGripperPoints, {}, (DepthToPoints,)),
    Case(DepthNoise, {"dropout": 0.1}, ()),
    Case(DelayObservation, {"names": [["camera", "mask"], "T_base_camera"]}, (), needs_time=True),
    Case(CameraPoseError, {}, ()),
    Case(JitterPoints, {}, (DepthToPoints,)),
    Case(DropPoints, {"dropped": 0.5}, (DepthToPoints,)),
    Case(TablePlane, {"height": 0.1}, ()),
    Case(WristAngle, {}, ()),
    Case(CameraImage, {"channels": "dm", "size": 8}, ()),
]


@pytest.fixture(params=CASES, ids=lambda case: case.kind.__name__)
def case(request) -> Case:
    return request.param


def make_base() -> GraspEnv:
    torch.set_num_threads(1)
    objects = ProceduralObjects("train", num_objects=2, num_grasps=100)
    camera = RaycastCamera(CameraIntrinsics(12, 12))
    return GraspEnv(2, objects=objects, camera=camera, horizon=HORIZON, seed=0)


def make_env(case: Case) -> TransformedEnv:
    return TransformedEnv(make_base(), Compose(*case.before(), case.make()))


@pytest.fixture(scope="module")
def raw() -> TensorDict:
    """(2, HORIZON) steps as the environment gives them."""
    torch.manual_seed(0)
    return make_base().rollout(HORIZON)


@pytest.fixture
def steps(case, raw) -> TensorDict:
    """(2, HORIZON) steps as they reach the transform."""
    data = raw.clone()
    return Compose(*case.before())(data) if case.behind else data


def names(tensordict: TensorDict) -> set:
    return set(tensordict.keys(True, True))


def test_every_transform_is_under_contract():
    public = {
        kind for kind in vars(library).values() if isinstance(kind, type) and issubclass(kind, Transform)
    }
    others = {library.PointTransform, library.HistoryTransform, RandomMirror, library.HindsightGoal}
    others.add(library.KeepFeatures)  # which needs an encoder
    assert public - others == {case.kind for case in CASES}


def test_specs_in_an_environment(case):
    check_env_specs(make_env(case), break_when_any_done="both")


def test_specs_of_a_batch_of_transformed_environments(case):
    check_env_specs(SerialEnv(2, lambda: make_env(case)))


def test_specs_of_a_transformed_batch_of_environments(case):
    env = TransformedEnv(SerialEnv(2, make_base), Compose(*case.before(), case.make()))
    check_env_specs(env)


def test_what_is_written_is_declared_as_it_is(case):
    env = make_env(case)
    state = env.reset()
    assert names(state) - {"done", "terminated", "truncated"} == set(env.observation_spec.keys(True, True))
    for key in case.make().out_keys:
        assert env.observation_spec[key].shape == state.get(key).shape
        assert env.observation_spec[key].dtype == state.get(key).dtype


def test_reset_and_step_are_transformed_alike(case):
    state = make_env(case).reset()
    after = make_env(case).rollout(2)["next"]
    for key in case.make().out_keys:
        assert state.get(key).shape[1:] == after.get(key).shape[2:], key
        assert state.get(key).dtype == after.get(key).dtype, key


def test_live_and_recorded_steps_are_transformed_alike(case, raw):
    torch.manual_seed(0)
    live = make_env(case).rollout(HORIZON)
    recorded = Compose(*case.before(), case.make())(raw.clone())
    assert names(live) == names(recorded)
    for key in names(live):
        assert torch.equal(live.get(key), recorded.get(key)), key


def test_without_next_the_current_state_is_transformed(case, steps):
    both = case.make()(steps.clone())
    alone = case.make()(steps.exclude("next").clone())
    for key in case.make().out_keys:
        assert torch.equal(alone.get(key), both.get(key)), key
    assert "next" not in alone


def test_any_batch_shape_is_welcome(case, steps):
    flat = steps.exclude("next")
    grid = torch.stack([flat, flat], dim=0)  # (2, 2, HORIZON)
    out = case.make()(grid.clone())
    expected = case.make()(flat.clone())
    for key in case.make().out_keys:
        assert torch.equal(out[1].get(key), expected.get(key)), key
    if not case.needs_time:
        single = case.make()(flat[1, 2].clone())
        for key in case.make().out_keys:
            assert torch.equal(single.get(key), expected.get(key)[1, 2]), key


def test_other_keys_and_the_inputs_tensors_stay(case, steps):
    held = {key: steps.get(key) for key in names(steps)}
    copies = {key: value.clone() for key, value in held.items()}
    out = case.make()(steps)
    assert all(torch.equal(held[key], copies[key]) for key in held)
    written = {unravel_key(("next", key)) for key in case.make().out_keys} | set(case.make().out_keys)
    for key in set(held) - written:
        assert torch.equal(out.get(key), copies[key]), key


def test_in_a_buffer_samples_are_transformed_and_the_store_is_not(case, steps):
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(10), batch_size=2)
    buffer.append_transform(case.make())
    buffer.extend(steps.clone())
    assert names(buffer.storage[:]) - {"index"} == names(steps)
    for key in case.make().in_keys:
        assert torch.equal(buffer.storage[:].get(key), steps.get(key)), key
    expected = case.make()(steps.clone())
    sample = buffer[:]
    for key in case.make().out_keys:
        for name in (key, ("next", key)):
            assert torch.equal(sample.get(name), expected.get(name)), name
    buffer.sample()
    assert torch.equal(buffer.storage[:].get(case.make().in_keys[0]), steps.get(case.make().in_keys[0]))


def test_the_inverse_changes_nothing(case, steps):
    out = case.make().inv(steps.clone())
    assert names(out) == names(steps)
    assert all(torch.equal(out.get(key), steps.get(key)) for key in names(steps))


def test_it_travels_to_worker_processes(case, steps):
    copy = pickle.loads(pickle.dumps(case.make()))
    a, b = copy(steps.clone()), case.make()(steps.clone())
    assert all(torch.equal(a.get(key), b.get(key)) for key in names(b))


def test_a_clone_serves_a_second_environment(case):
    first = make_env(case)
    second = TransformedEnv(make_base(), first.transform.clone())
    torch.manual_seed(0)
    a = first.rollout(2)
    torch.manual_seed(0)
    b = second.rollout(2)
    for key in case.make().out_keys:
        assert torch.equal(a.get(key), b.get(key)), key
