"""What transforms remember of an episode: whose it is, and where it begins anew."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, SliceSampler, TensorDictReplayBuffer, Unbounded
from torchrl.data.tensor_specs import Composite
from torchrl.envs import CatFrames, Compose, EnvBase, MultiAction, StepCounter, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AggregatePoints, DelayObservation, DepthToPoints


def make_state(value: float) -> TensorDict:
    """One cloud whose four points are all `value`, and a mask that is set where it is above 0."""
    return TensorDict(
        {
            "points": torch.full((1, 4, 3), value),
            "num_points": torch.tensor([[4]]),
            "T_base_ee": torch.eye(4)[None],
            "camera": {"mask": torch.full((1, 2, 2), value > 0)},
        },
        [1],
    )


@pytest.mark.parametrize("make", [AggregatePoints, DelayObservation])
def test_a_clone_shares_no_memory(make):
    first = make()
    first._reset(TensorDict({}, [1]), make_state(0.0))
    second = first.clone()
    assert type(second) is make and second._memories == []
    second._reset(TensorDict({}, [1]), make_state(9.0))
    after = first._step(TensorDict({}, [1]), make_state(0.0))
    assert after["points"].abs().max() == 0.0 and not after["camera", "mask"].any()


def test_clones_in_environments_of_their_own_share_no_memory():
    first = DelayObservation(1, names=["points"])
    envs = [TransformedEnv(Counting(), each) for each in (first, first.clone())]
    state, other = (env.reset() for env in envs)
    for _ in range(3):
        other = envs[1].step(act(other))["next"]
    after = envs[0].step(act(state))["next"]
    assert after["points"][0, 0, 0] == 0.0 and other["points"][0, 0, 0] == 2.0


@pytest.mark.parametrize("make", [AggregatePoints, DelayObservation])
def test_a_step_before_a_reset_is_refused(make):
    with pytest.raises(ConfigError, match=r"reset of 0 worlds and a step of 1: reset the environment"):
        make()._step(TensorDict({}, [1]), make_state(0.0))


class Counting(EnvBase):
    """Counts its steps, in a cloud of one point; ends at `last`, and resets itself if asked to."""

    def __init__(self, last: int = 100, *, resets_itself: bool = False) -> None:
        super().__init__(batch_size=[1])
        shapes = {"points": (1, 1, 3), "T_base_ee": (1, 4, 4)}
        entries = {name: Unbounded(shape) for name, shape in shapes.items()}
        entries["num_points"] = Unbounded((1, 1), dtype=torch.int64)
        self.observation_spec = Composite(entries, shape=(1,))
        self.action_spec, self.reward_spec = Unbounded((1, 1)), Unbounded((1, 1))
        self.last, self.count = last, 0
        self._torchrl_native_autoreset = resets_itself

    def _observe(self) -> TensorDict:
        cloud = torch.full((1, 1, 3), float(self.count))
        counts = torch.ones(1, 1, dtype=torch.int64)
        return TensorDict({"points": cloud, "num_points": counts, "T_base_ee": torch.eye(4)[None]}, [1])

    def _reset(self, tensordict=None, **_) -> TensorDict:
        self.count = 0
        return self._observe()

    def _step(self, tensordict) -> TensorDict:
        self.count += 1
        done = torch.full((1, 1), self.count == self.last)
        if self._torchrl_native_autoreset and done.all():
            self.count = 0
        outcome = {"reward": torch.zeros(1, 1), "done": done, "terminated": done.clone()}
        return self._observe().update(outcome)

    def _set_seed(self, seed) -> None: ...


def act(state):
    return state.set("action", torch.zeros(1, 1))


def see_states(env, num_steps: int) -> list[TensorDict]:
    state, seen = env.reset(), []
    for _ in range(num_steps):
        seen.append(state.clone())
        _, state = env.step_and_maybe_reset(act(state))
    return seen


@pytest.mark.parametrize("resets_itself", [False, True])
def test_an_episode_begins_anew_whoever_resets_the_environment(resets_itself):
    env = TransformedEnv(
        Counting(3, resets_itself=resets_itself),
        Compose(StepCounter(), DelayObservation(1, names=["points"])),
    )
    seen = see_states(env, 7)
    assert [int(state["step_count"]) for state in seen] == [0, 1, 2, 0, 1, 2, 0]
    assert [int(state["points"][0, 0, 0]) for state in seen] == [0, 0, 1, 0, 0, 1, 0]
    env = TransformedEnv(Counting(3, resets_itself=resets_itself), AggregatePoints(1.0, max_points=4))
    seen = see_states(env, 7)
    assert [int(state["num_points"]) for state in seen] == [1, 2, 3, 1, 2, 3, 1]
    assert seen[5]["points"][0, :, 0].tolist() == [0, 1, 2, 0]


def test_what_torchrl_would_not_call_again_is_refused():
    frames = CatFrames(2, dim=-1, in_keys=["points"])
    chain = Compose(DelayObservation(1, names=["points"]), Compose(StepCounter(), frames))
    env = TransformedEnv(Counting(3, resets_itself=True), chain)
    with pytest.raises(ConfigError, match=r"CatFrames reads what DelayObservation writes.*resets itself"):
        see_states(env, 1)


def test_a_chunk_of_actions_is_as_many_steps():
    torch.set_num_threads(1)
    objects = ProceduralObjects("train", num_objects=1, num_grasps=100)

    def make_env(*transforms) -> TransformedEnv:
        camera = RaycastCamera(CameraIntrinsics(16, 16))
        late = DelayObservation(1, names=["T_base_object"])
        chain = Compose(DepthToPoints(), AggregatePoints(0.5, max_points=400), late, *transforms)
        return TransformedEnv(GraspEnv(2, objects=objects, camera=camera, horizon=8, seed=0), chain)

    chunked, plain = make_env(MultiAction(dim=1, stack_rewards=False)), make_env()
    macro, state = chunked.reset(), plain.reset()
    for _ in range(2):
        macro = chunked.step(macro.set("action", torch.full((2, 3, 6), 0.01)))["next"]
        for _ in range(3):
            state = plain.step(state.set("action", torch.full((2, 6), 0.01)))["next"]
        for key in ("points", "num_points", "T_base_object", "time_left"):
            assert torch.equal(macro[key], state[key]), key


def test_trajectories_that_meet_share_nothing_however_they_lie():
    seen = torch.arange(6.0).reshape(2, 3, 1)
    ids = torch.tensor([[0] * 3, [1] * 3])
    following = {"seen": seen + 1, "done": torch.zeros(2, 3, 1, dtype=torch.bool)}
    steps = TensorDict({"seen": seen, "collector": {"traj_ids": ids}, "next": following}, [2, 3])
    for data in (steps.clone(), steps.clone().reshape(-1), steps.exclude("next").reshape(-1)):
        out = DelayObservation(1, names=["seen"])(data)
        assert out["seen"].flatten().tolist() == [0, 0, 1, 3, 3, 4]
        if "next" in out:
            assert out["next", "seen"].flatten().tolist() == [0, 1, 2, 3, 4, 5]


def test_slices_that_a_buffer_draws_share_nothing():
    steps = TensorDict(
        {
            "seen": torch.arange(20.0)[:, None],
            "episode": torch.arange(20) // 10,
            "next": {"seen": torch.arange(20.0)[:, None] + 1, "done": (torch.arange(20) % 10 == 9)[:, None]},
        },
        [20],
    )
    # Stacked first, as CatFrames.make_rb_transform_and_sampler does: where slices end is written afterwards.
    chain = Compose(lambda rows: rows.reshape(-1, 3), DelayObservation(1, names=["seen"]))
    sampler = SliceSampler(slice_len=3, traj_key="episode")
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(20), sampler=sampler, batch_size=30, transform=chain
    )
    buffer.extend(steps)
    batch, _ = buffer.sample(return_info=True, include_info=False)
    start = batch["next", "seen"][:, 0, 0]
    assert batch.shape == (10, 3) and start.unique().numel() > 2
    assert torch.equal(batch["seen"][..., 0], start[:, None] + torch.tensor([0.0, 0.0, 1.0]))
