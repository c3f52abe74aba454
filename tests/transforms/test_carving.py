"""AggregatePoints(carve=...): points that the camera looks through have moved away."""

import math

import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.geometry import transform_points
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import AggregatePoints, DepthToPoints

OBJECTS = ProceduralObjects("train", num_objects=3, num_grasps=100)


def two_views(points: list[list[float]], depth: torch.Tensor) -> set[tuple[float, ...]]:
    """What is left of points seen first, once a camera in the origin that looks along z sees `depth`."""
    cloud = torch.zeros(2, len(points), 3)
    cloud[0] = torch.tensor(points)
    pictures = torch.stack((torch.ones_like(depth), depth))
    steps = TensorDict(
        {
            "points": cloud,
            "num_points": torch.tensor([[len(points)], [0]]),
            "T_base_ee": torch.eye(4).expand(2, 4, 4),
            "T_base_camera": torch.eye(4).expand(2, 4, 4),
            "camera": {"depth": pictures},
        },
        [2],
    )
    last = AggregatePoints(alpha=1.0, carve=0.01, fov=math.pi / 2)(steps)[1]
    kept = last["points"][: int(last["num_points"])]
    return {tuple(round(value, 3) for value in row) for row in kept.tolist()}


def test_a_point_before_what_is_seen_goes_and_one_on_or_behind_it_stays():
    before, on, behind = [0.0, 0.0, 0.5], [0.0, 0.0, 0.995], [0.0, 0.0, 2.0]
    left = two_views([before, on, behind], torch.ones(20, 20))
    assert left == {tuple(on), tuple(behind)}


def test_points_out_of_view_stay():
    beside, at_the_back = [2.0, 0.0, 0.5], [0.0, 0.0, -0.5]
    assert two_views([beside, at_the_back], torch.ones(20, 20)) == {tuple(beside), tuple(at_the_back)}


def test_where_nothing_returns_there_is_nothing():
    assert two_views([[0.0, 0.0, 0.5]], torch.zeros(20, 20)) == set()


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
