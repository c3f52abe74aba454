"""Aggregation by hand-computed counts and places, in an environment, a buffer and on bare data."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose, invert_pose, transform_points
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AggregatePoints, DepthToPoints

OBJECTS = ProceduralObjects("train", num_objects=3, num_grasps=100)


def make_steps(counts: list[list[int]], *, width: int = 120) -> TensorDict:
    """(B, T) views: point i of view t of world b lies at (b, t, i) in the base; hands move about."""
    n = torch.tensor(counts)
    shape = n.shape
    generator = torch.Generator().manual_seed(0)
    T_base_ee = action_to_pose(torch.rand(*shape, 6, generator=generator) - 0.5)
    b, t, i = torch.meshgrid(*(torch.arange(size) for size in (*shape, width)), indexing="ij")
    in_base = torch.stack((b, t, i), dim=-1).float()
    points = transform_points(invert_pose(T_base_ee), in_base)
    points[i >= n[..., None]] = 0.0
    return TensorDict({"points": points, "num_points": n[..., None], "T_base_ee": T_base_ee}, shape)


def with_next(steps: TensorDict, done: list[list[bool]]) -> TensorDict:
    """(B, T - 1) transitions whose next view is the following one; `done` marks ends of episodes."""
    out = steps[:, :-1].clone()
    after = steps[:, 1:].clone().set("done", torch.tensor(done)[..., None])
    return out.set("next", after)


def in_base(steps: TensorDict, b: int, t: int) -> list[tuple[int, int, int]]:
    """The union of world b at t as (world, view, point) names."""
    step = steps[b, t]
    cloud = step["points"][: int(step["num_points"])]
    return [tuple(row) for row in transform_points(step["T_base_ee"], cloud).round().long().tolist()]


def test_of_each_view_alpha_to_the_t_are_kept():
    counts = [[100, 100, 100, 100], [10, 7, 0, 3]]
    steps = AggregatePoints(0.9, max_points=500)(make_steps(counts))
    kept = [[100, 90, 81, 73], [10, 7, 0, 3]]  # ceil(0.9^t n): 72.9 -> 73; 6.3 -> 7; 2.187 -> 3
    for b in range(2):
        for t in range(4):
            names = in_base(steps, b, t)
            assert len(set(names)) == len(names) == sum(kept[b][: t + 1])
            for view in range(t + 1):
                assert sum(name[1] == view for name in names) == kept[b][view]
            assert all(name[0] == b and name[1] <= t for name in names)


def test_the_union_is_expressed_in_the_hand_frame_of_its_own_step():
    views = make_steps([[5, 5, 5]])
    steps = AggregatePoints(1.0, max_points=20)(views.clone())
    first = transform_points(views["T_base_ee"][0, 0], views["points"][0, 0, :5])
    now = transform_points(invert_pose(views["T_base_ee"][0, 2]), first)
    assert torch.allclose(steps["points"][0, 2, :5], now, atol=1e-5)
    assert torch.allclose(steps["points"][0, 2, 10:15], views["points"][0, 2, :5], atol=1e-5)
    assert not steps["points"][0, 2, 15:].any()


def test_earlier_points_stay_once_they_were_drawn():
    steps = AggregatePoints(0.8, max_points=500)(make_steps([[50] * 5]))
    for t in range(4):
        assert set(in_base(steps, 0, t)) < set(in_base(steps, 0, t + 1))


def test_alpha_one_keeps_every_point():
    steps = AggregatePoints(1.0, max_points=500)(make_steps([[20, 30, 40]]))
    assert steps["num_points"].flatten().tolist() == [20, 50, 90]


def test_beyond_its_width_the_union_is_thinned_evenly():
    steps = AggregatePoints(1.0, max_points=100)(make_steps([[100] * 4], width=100))
    assert steps["num_points"].flatten().tolist() == [100] * 4
    names = in_base(steps, 0, 3)
    assert len(set(names)) == 100
    assert sum(name[1] == 3 for name in names) == pytest.approx(50, abs=15)


def test_transitions_are_aggregated_alike_with_and_without_next():
    views = make_steps([[30, 20, 10, 5], [6, 5, 4, 3]])
    plain = AggregatePoints(1.0, max_points=200)(views.clone())
    steps = AggregatePoints(1.0, max_points=200)(with_next(views, [[False] * 3] * 2))
    for key in ("points", "num_points"):
        assert torch.equal(steps[key], plain[:, :-1][key]), key
        assert torch.equal(steps["next", key], plain[:, 1:][key]), key
    assert not steps["next", "done"].any()


def test_a_union_begins_anew_after_an_end():
    views = make_steps([[4, 4, 4, 4, 4], [4, 4, 4, 4, 4]])
    steps = with_next(views, [[False, True, False, False], [False] * 4])
    AggregatePoints(1.0, max_points=60)(steps)
    assert steps["num_points"][0].flatten().tolist() == [4, 8, 4, 8]
    assert steps["next", "num_points"][0].flatten().tolist() == [8, 12, 8, 12]
    assert steps["num_points"][1].flatten().tolist() == [4, 8, 12, 16]


def test_a_new_view_counts_from_zero_after_an_end():
    views = make_steps([[100] * 4])
    steps = with_next(views, [[False, True, False]])
    AggregatePoints(0.9, max_points=400)(steps)
    assert steps["next", "num_points"][0].flatten().tolist() == [190, 271, 190]
    assert steps["num_points"][0].flatten().tolist() == [100, 190, 100]


def test_in_a_buffer_whole_episodes_are_aggregated():
    views = make_steps([[100, 100, 100]] * 4)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(10), batch_size=3)
    buffer.append_transform(AggregatePoints(0.9, max_points=300))
    buffer.extend(views)
    assert torch.equal(buffer[:]["num_points"][:, -1], torch.full((4, 1), 271))
    sample = buffer.sample()
    assert sample.shape[:2] == (3, 3)
    assert sample["num_points"][0].flatten().tolist() == [100, 190, 271]


def make_env(num_envs: int, *, alpha: float = 0.5, first_world: int = 0, horizon: int = 4) -> TransformedEnv:
    torch.set_num_threads(1)
    camera = RaycastCamera(CameraIntrinsics(16, 16))
    base = GraspEnv(
        num_envs, objects=OBJECTS, camera=camera, horizon=horizon, first_world=first_world, seed=0
    )
    return TransformedEnv(base, Compose(DepthToPoints(), AggregatePoints(alpha, max_points=400)))


def slow(tensordict: TensorDict) -> TensorDict:
    return tensordict.set("action", torch.full((*tensordict.batch_size, 6), 0.01))


def test_counts_in_an_environment():
    steps = make_env(4).rollout(4, slow)
    seen = (steps["camera", "mask"] & (steps["camera", "depth"] > 0)).flatten(2).sum(-1)
    assert seen.max() > 10
    for world in range(4):
        kept = [math.ceil(0.5**t * int(n)) for t, n in enumerate(seen[world])]
        expected = [sum(kept[: t + 1]) for t in range(4)]
        assert steps["num_points"][world].flatten().tolist() == expected


def test_an_environment_and_its_bare_rollout_aggregate_alike():
    live = make_env(3).rollout(4, slow)
    camera_only = GraspEnv(
        3, objects=OBJECTS, camera=RaycastCamera(CameraIntrinsics(16, 16)), horizon=4, seed=0
    )
    recorded = Compose(DepthToPoints(), AggregatePoints(0.5, max_points=400))(camera_only.rollout(4, slow))
    for key in ("points", "num_points", ("next", "points"), ("next", "num_points")):
        assert torch.equal(live[key], recorded[key]), key


def test_the_union_lies_on_the_object_where_it_stands():
    steps = make_env(4, alpha=1.0).rollout(4, slow)
    last = steps[:, -1]
    for world in last:
        cloud = world["points"][: int(world["num_points"])]
        T_object_ee = torch.linalg.solve(world["T_base_object"], world["T_base_ee"])
        local = transform_points(T_object_ee, cloud)
        size = torch.from_numpy(OBJECTS[int(world["object_id"])].vertices).abs().amax(0)
        assert torch.all(local.abs() < size + 0.005)


def test_a_world_sees_the_same_points_whatever_its_batch():
    def eight_steps(env):
        state, out = env.reset(), []
        for _ in range(8):
            step, state = env.step_and_maybe_reset(slow(state))
            out.append(step)
        return torch.stack(out, dim=1)

    together = eight_steps(make_env(4))
    for world in range(4):
        alone = eight_steps(make_env(1, first_world=world))
        for key in ("points", "num_points", ("next", "points")):
            assert torch.equal(alone[key][0], together[key][world]), key


def test_a_partial_reset_clears_the_union_of_that_world_alone():
    env = make_env(3, alpha=1.0)
    state = env.reset()
    for _ in range(2):
        state = env.step(slow(state))["next"].exclude("reward")
    before = state["num_points"].flatten().tolist()
    mask = torch.tensor([[False], [True], [False]])
    state = env.reset(state.set("_reset", mask))
    seen = (state["camera", "mask"] & (state["camera", "depth"] > 0)).flatten(1).sum(-1)
    assert state["num_points"].flatten().tolist() == [before[0], int(seen[1]), before[2]]


@pytest.mark.parametrize("options", [{"alpha": 2.0}, {"alpha": 0.0}, {"alpha": -0.5}, {"max_points": 0}])
def test_impossible_numbers_are_refused(options):
    with pytest.raises(ConfigError, match=f"^{next(iter(options))}="):
        AggregatePoints(**options)


def test_without_a_time_dimension_it_says_what_to_give():
    with pytest.raises(ConfigError, match="time dimension"):
        AggregatePoints()(make_steps([[3]])[0, 0])
