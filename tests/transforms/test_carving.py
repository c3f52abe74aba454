"""AggregatePoints(carve=...): points that the camera looks through have moved away."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.geometry import transform_points
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AggregatePoints, DepthToPoints

OBJECTS = ProceduralObjects("train", num_objects=3, num_grasps=100)
Points = list[list[float]]


def see_views(views: list[tuple[Points, torch.Tensor]]) -> list[set[tuple[float, ...]]]:
    """What is known after each view, target points and depth: a camera in the origin looks along z."""
    cloud = torch.zeros(len(views), max(1, *(len(points) for points, _ in views)), 3)
    for row, (points, _) in zip(cloud, views, strict=True):
        row[: len(points)] = torch.tensor(points).reshape(-1, 3)
    steps = TensorDict(
        {
            "points": cloud,
            "num_points": torch.tensor([[len(points)] for points, _ in views]),
            "T_base_ee": torch.eye(4).expand(len(views), 4, 4),
            "T_base_camera": torch.eye(4).expand(len(views), 4, 4),
            "camera": {"depth": torch.stack([depth for _, depth in views])},
        },
        [len(views)],
    )
    seen = AggregatePoints(alpha=1.0, carve=0.01, fov=math.pi / 2)(steps)
    kept = [step["points"][: int(step["num_points"])].tolist() for step in seen]
    return [{tuple(round(value, 3) for value in row) for row in rows} for rows in kept]


def two_views(points: Points, depth: torch.Tensor) -> set[tuple[float, ...]]:
    """What is left of points seen first, once the camera sees `depth` and none of them."""
    return see_views([(points, torch.ones_like(depth)), ([], depth)])[1]


def test_a_point_before_what_is_seen_goes_and_one_on_or_behind_it_stays():
    before, on, behind = [0.0, 0.0, 0.5], [0.0, 0.0, 0.995], [0.0, 0.0, 2.0]
    left = two_views([before, on, behind], torch.ones(20, 20))
    assert left == {tuple(on), tuple(behind)}


def test_points_out_of_view_stay():
    beside, at_the_back = [2.0, 0.0, 0.5], [0.0, 0.0, -0.5]
    assert two_views([beside, at_the_back], torch.ones(20, 20)) == {tuple(beside), tuple(at_the_back)}


def test_where_nothing_returns_there_is_nothing():
    ahead, beside = [0.0, 0.0, 0.5], [2.0, 0.0, 0.5]
    assert two_views([ahead, beside], torch.zeros(20, 20)) == {tuple(beside)}


def test_a_target_that_has_gone_leaves_its_last_place_until_it_is_seen_again():
    far, depth, near = [0.1, 0.0, 1.0], torch.ones(20, 20), torch.full((20, 20), 0.4)
    seen = ([[0.2, 0.1, 0.5], [0.4, 0.1, 0.5]], depth)
    known = see_views([seen, ([], depth), ([], near), ([far], near), ([], 2 * depth)])
    assert known[0] == {(0.2, 0.1, 0.5), (0.4, 0.1, 0.5)}
    assert known[1] == known[2] == {(0.3, 0.1, 0.5)}  # behind what is near it is not seen through
    assert known[3] == {tuple(far)}
    assert known[4] == {tuple(far)}  # its own last place


def test_a_target_that_has_gone_goes_on_as_it_went_ever_more_slowly():
    depth = torch.ones(20, 20)
    seen = [([[x, 0.0, 0.5]], depth) for x in (0.0, 0.1, 0.12)]  # the largest of the last shifts counts
    *_, first, second, third = see_views([*seen, *[([], depth)] * 3])
    steps = 0.1 * torch.tensor([0.85, 0.85**2, 0.85**3])
    expected = (0.12 + steps.cumsum(0)).tolist()
    assert [list(point) for point in (*first, *second, *third)] == [
        pytest.approx([x, 0.0, 0.5], abs=1e-3) for x in expected
    ]
    again = see_views([*seen, ([], depth), ([[-0.3, 0.0, 0.5]], depth), ([], depth)])
    assert again[-1] == {(-0.3, 0.0, 0.5)}  # nobody knows how it came there


def test_each_world_has_its_own_last_place_until_its_reset():
    def state(counts: list[int]) -> TensorDict:
        """Two worlds; where there is a point, it lies 0.5 ahead."""
        return TensorDict(
            {
                "points": torch.tensor([0.0, 0.0, 0.5]).expand(2, 1, 3),
                "num_points": torch.tensor(counts)[:, None],
                "T_base_ee": torch.eye(4).expand(2, 4, 4),
                "T_base_camera": torch.eye(4).expand(2, 4, 4),
                "camera": {"depth": torch.ones(2, 20, 20)},
            },
            [2],
        )

    transform = AggregatePoints(carve=0.01, fov=math.pi / 2)
    assert transform._reset(TensorDict({}, [2]), state([1, 0]))["num_points"].tolist() == [[1], [0]]
    assert transform._step(TensorDict({}, [2]), state([0, 0]))["num_points"].tolist() == [[1], [0]]
    again = TensorDict({"_reset": torch.tensor([[True], [False]])}, [2])
    assert transform._reset(again, state([0, 0]))["num_points"].tolist() == [[0], [0]]


def test_where_no_target_was_seen_none_is_known():
    assert see_views([([], torch.ones(20, 20))] * 2) == [set(), set()]


def test_outlines_stay():
    depth = torch.ones(20, 20)
    depth[:, 11] = 0.5  # the edge of something half as far
    one_pixel_beside, far_from_it = [0.025, 0.0, 0.5], [-0.3, 0.0, 0.5]
    assert two_views([one_pixel_beside, far_from_it], depth) == {tuple(one_pixel_beside)}


def hold(state: TensorDict) -> TensorDict:
    return state.set("action", torch.zeros(4, 6))


def rollout(motion: str, carve: float | None):
    chain = Compose(DepthToPoints(), AggregatePoints(alpha=1.0, max_points=4000, carve=carve))
    camera = RaycastCamera(CameraIntrinsics(32, 32))
    env = GraspEnv(4, objects=OBJECTS, camera=camera, horizon=8, seed=1, target_motion=motion)
    return TransformedEnv(env, chain).rollout(8, hold)


def test_where_nothing_moves_nothing_goes():
    with_it, without = (rollout("static", carve)["num_points"] for carve in (0.005, None))
    assert torch.equal(with_it, without)


def test_what_is_left_of_a_moving_target_lies_where_the_target_is():
    def spread(carve):
        """Largest distance of a point from the object's middle, in its own frame, the worst world's mean."""
        steps = rollout("jitter", carve)[:, -1]
        distances = []
        for world in steps:
            cloud = world["points"][: int(world["num_points"])]
            T_object_ee = torch.linalg.solve(world["T_base_object"], world["T_base_ee"])
            distances.append(transform_points(T_object_ee, cloud).norm(dim=-1).mean())
        return torch.stack(distances).max()

    assert spread(0.005) < 0.8 * spread(None)
