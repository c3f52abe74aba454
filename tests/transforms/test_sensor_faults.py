"""Noise, holes, delays, wrong poses, lost points: by properties and hand-computed numbers."""

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose, invert_pose
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, RaycastCamera
from torchgrasp.transforms import (
    AppendGripperPoints,
    CameraPoseError,
    DelayObservation,
    DepthNoise,
    DepthToPoints,
    DropPoints,
    JitterPoints,
)

QUIET = {"axial": (0, 0, 0), "lateral": 0, "disparity_step": 0, "edge_holes": 0, "dropout": 0}


def wall(distance: float, size: int = 200) -> TensorDict:
    mask = torch.zeros(size, size, dtype=torch.bool)
    mask[:, size // 2 :] = True
    return TensorDict({"camera": {"depth": torch.full((size, size), distance), "mask": mask}})


def noisy(picture: TensorDict, **options) -> tuple[torch.Tensor, torch.Tensor]:
    out = DepthNoise(**{**QUIET, **options})(picture.clone())["camera"]
    return out["depth"], out["mask"]


def test_axial_noise_grows_with_distance_as_measured():
    # Nguyen et al. 2012: 1.2 mm at 0.4 m, 1.2 + 1.9 * 0.6^2 = 1.884 mm at 1 m.
    for distance, expected in ((0.4, 0.0012), (1.0, 0.001884), (2.0, 0.006064)):
        depth, _ = noisy(wall(distance), axial=(0.0012, 0.0019, 0.4))
        assert depth.mean().item() == pytest.approx(distance, abs=2e-4)
        assert depth.std().item() == pytest.approx(expected, rel=0.03)


def test_depth_keeps_to_what_disparities_tell_apart():
    # 1 / 0.3 = 3.333 is nearest to 6 * 0.5 = 3 or 7 * 0.5 = 3.5: the latter, 0.2857 m.
    depth, _ = noisy(wall(0.3), disparity_step=0.5)
    assert torch.allclose(depth, torch.tensor(1 / 3.5))
    far, _ = noisy(wall(9.0), disparity_step=0.5)
    assert torch.allclose(far, torch.tensor(2.0))


def test_holes_are_at_edges_of_depth_and_masked_out():
    picture = wall(1.0, 100)
    picture["camera", "depth"][:, 50:] = 0.5
    depth, mask = noisy(picture, edge_holes=1.0)
    assert not depth[:, 49:51].any() and not mask[:, 49:51].any()
    rest = torch.cat((depth[:, :49], depth[:, 51:]), dim=1)
    assert rest.min() == 0.5 and mask[:, 51:].all()


def test_dropouts_occur_as_often_as_said():
    depth, mask = noisy(wall(1.0), dropout=0.2)
    assert (depth == 0).float().mean().item() == pytest.approx(0.2, abs=0.01)
    assert torch.equal(mask, wall(1.0)["camera", "mask"] & (depth > 0))


def test_sideways_noise_moves_depth_and_mask_together():
    picture = wall(1.0)
    picture["camera", "depth"][picture["camera", "mask"]] = 0.5
    depth, mask = noisy(picture, lateral=1.0)
    assert torch.equal(mask, depth == 0.5)
    changed = (mask != picture["camera", "mask"]).float().mean(0)
    assert changed[99:101].min() > 0.2 and changed[:90].max() == 0 == changed[110:].max()


def test_without_faults_nothing_changes_and_nothing_seen_stays_so():
    picture = wall(1.0)
    picture["camera", "depth"][:10] = 0.0
    depth, _ = noisy(picture)
    assert torch.equal(depth, picture["camera", "depth"])
    depth, _ = noisy(picture, axial=(0.01, 0.0, 0.0), disparity_step=0.1)
    assert not depth[:10].any() and depth[10:].min() > 0


def counted(*, steps: int = 6, worlds: int = 1) -> TensorDict:
    """(worlds, steps) transitions: "seen" counts 100 per world and 1 per step."""
    seen = (torch.arange(steps) + 100 * torch.arange(worlds)[:, None]).float()[..., None]
    done = torch.zeros(worlds, steps, 1, dtype=torch.bool)
    return TensorDict({"seen": seen, "next": {"seen": seen + 1, "done": done}}, [worlds, steps])


def test_a_delay_repeats_the_first_and_begins_anew_after_an_end():
    data = counted(worlds=2)
    data["next", "done"][1, 2] = True  # world 1 ends after step 2
    out = DelayObservation(2, names=["seen"])(data)
    assert out["seen"][0, :, 0].tolist() == [0, 0, 0, 1, 2, 3]
    assert out["next", "seen"][0, :, 0].tolist() == [0, 0, 1, 2, 3, 4]
    assert out["seen"][1, :, 0].tolist() == [100, 100, 100, 103, 103, 103]
    assert out["next", "seen"][1, :, 0].tolist() == [100, 100, 101, 103, 103, 104]


OBJECTS = ProceduralObjects("train", num_objects=2, num_grasps=100)


def make_env(num_envs: int, *transforms, first_world: int = 0, horizon: int = 4) -> TransformedEnv:
    torch.set_num_threads(1)
    camera = RaycastCamera(CameraIntrinsics(16, 16))
    base = GraspEnv(
        num_envs, objects=OBJECTS, camera=camera, horizon=horizon, first_world=first_world, seed=0
    )
    return TransformedEnv(base, Compose(*transforms))


def slow(tensordict):
    return tensordict.set("action", torch.full((*tensordict.batch_size, 6), 0.02))


def test_the_mask_lags_behind_the_depth_and_the_whole_view_is_old():
    plain = make_env(2).rollout(4, slow)
    late = make_env(2, DelayObservation(1)).rollout(4, slow)
    assert torch.equal(late["camera", "depth"], plain["camera", "depth"])
    assert torch.equal(late["camera", "mask"][:, 1:], plain["camera", "mask"][:, :-1])
    assert torch.equal(late["next", "camera", "mask"], plain["camera", "mask"])
    names = [("camera", "depth"), ("camera", "mask"), "T_base_camera"]
    old = make_env(2, DelayObservation(1, names=names)).rollout(4, slow)
    for name in names:
        assert torch.equal(old["next"].get(name), plain.get(name))
    assert torch.equal(old["next", "T_base_ee"], plain["next", "T_base_ee"])


def test_a_partial_reset_fills_the_delay_line_of_that_world_alone():
    env = make_env(2, DelayObservation(2, names=["T_base_ee"]))
    first = state = env.reset()
    seen = first["T_base_ee"].clone()
    for _ in range(2):
        state = env.step(slow(state))["next"].exclude("reward")
    assert torch.equal(state["T_base_ee"], seen)
    state = env.reset(state.set("_reset", torch.tensor([[False], [True]])))
    assert torch.equal(state["T_base_ee"][0], seen[0])
    fresh = state["T_base_ee"][1].clone()
    state = env.step(slow(state))["next"]
    assert not torch.equal(state["T_base_ee"][0], seen[0]) and torch.equal(state["T_base_ee"][1], fresh)


def test_a_world_meets_the_same_faults_whatever_its_batch():
    def chain():
        return (
            DepthNoise(dropout=0.1),
            DelayObservation(1),
            CameraPoseError(),
            DepthToPoints(),
            JitterPoints(),
            DropPoints(probability=1.0),
        )

    together = make_env(3, *chain()).rollout(4, slow)
    for world in range(3):
        alone = make_env(1, *chain(), first_world=world).rollout(4, slow)
        for key in ("points", "num_points", ("camera", "depth"), "T_base_camera", ("next", "points")):
            assert torch.equal(alone[key][0], together[key][world]), key


def test_the_camera_is_off_by_one_error_an_episode_within_its_limits():
    env = make_env(3, CameraPoseError(translation=0.01, rotation=0.05))
    steps = env.rollout(4, slow)
    true = make_env(3).rollout(4, slow)["T_base_camera"]
    error = invert_pose(true) @ steps["T_base_camera"]
    assert torch.allclose(error, error[:, :1].expand_as(error), atol=1e-6)
    assert (error[0, 0] - error[1, 0]).abs().max() > 1e-4
    again = env.rollout(4, slow)["T_base_camera"]  # the next episode
    assert not torch.allclose(again, steps["T_base_camera"])
    assert torch.equal(steps["next", "T_base_camera"][:, :-1], steps["T_base_camera"][:, 1:])


def test_camera_errors_fill_their_ranges():
    poses = TensorDict({"T_base_camera": torch.eye(4).expand(2000, 4, 4)}, [2000])
    error = CameraPoseError(translation=0.01, rotation=0.05)(poses)["T_base_camera"].double()
    distance = error[:, :3, 3].norm(dim=-1)
    assert 0.0099 < distance.max() <= 0.01 + 1e-6
    assert distance.median().item() == pytest.approx(0.01 * 0.5 ** (1 / 3), rel=0.03)  # a ball's
    angle = torch.acos(((error[:, 0, 0] + error[:, 1, 1] + error[:, 2, 2] - 1) / 2).clamp(-1, 1))
    assert 0.049 < angle.max() <= 0.0505 and angle.median().item() == pytest.approx(0.025, rel=0.1)


def cloud(n: int = 400, width: int = 500) -> TensorDict:
    points = torch.rand(n, 3, generator=torch.Generator().manual_seed(0))
    points = torch.cat((points, torch.zeros(width - n, 3)))
    return TensorDict({"points": points, "num_points": torch.tensor([n])})


def test_jitter_has_its_size_and_leaves_what_is_no_point():
    before = cloud()["points"]
    moved = JitterPoints(0.01, bound=0.02)(cloud())["points"] - before
    assert not moved[400:].any() and moved.abs().max() <= 0.02 + 1e-6
    assert moved[:400].std().item() == pytest.approx(0.0088, rel=0.1)  # 0.01, cut off at two sigma


@pytest.mark.parametrize("part", ["ball", "half_space"])
def test_what_is_hidden_is_one_part_and_the_rest_keep_their_order(part):
    transform = DropPoints(dropped=0.0, occluded=0.6, part=part, probability=1.0)
    for _ in range(20):
        out = transform(cloud())
        n = int(out["num_points"])
        kept, every = out["points"][:n].tolist(), cloud()["points"][:400].tolist()
        stays = [point in kept for point in every]
        assert [point for point, stay in zip(every, stays, strict=True) if stay] == kept
        assert 160 <= n <= 400 and not out["points"][n:].any()
        lost = np.array(every)[~np.array(stays)]
        if part == "ball" and len(lost) > 1:
            # Some lost point is the middle: every other lost point is nearer to it than any kept one.
            to_lost = np.linalg.norm(lost[:, None] - lost, axis=-1).max(axis=1)
            to_kept = np.linalg.norm(lost[:, None] - np.array(kept), axis=-1).min(axis=1)
            assert (to_lost <= to_kept + 1e-6).any()


def test_random_losses_have_their_share_and_may_take_everything():
    assert DropPoints(dropped=0.25, probability=0.0)(cloud())["num_points"].item() == 300
    assert DropPoints(dropped=1.0, probability=0.0)(cloud())["num_points"].item() == 0
    assert DropPoints()(cloud(0))["num_points"].item() == 0


def test_the_overhead_camera_gives_points_as_the_wrists_does():
    torch.manual_seed(0)
    depth, mask = torch.rand(6, 6) + 0.1, torch.rand(6, 6) > 0.5
    T_base_ee, T_base_overhead = action_to_pose(torch.rand(2, 6))
    wrist = {"camera": {"depth": depth, "mask": mask}, "T_base_camera": T_base_overhead}
    overhead = {"overhead": {"depth": depth, "mask": mask}, "T_base_overhead": T_base_overhead}
    a = DepthToPoints()(TensorDict({**wrist, "T_base_ee": T_base_ee}))
    b = DepthToPoints(camera="overhead")(TensorDict({**overhead, "T_base_ee": T_base_ee}))
    assert torch.equal(a["points"], b["points"])


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: DepthNoise(axial=(1, 2)), "a, b, c"),
        (lambda: DepthNoise(dropout=1.5), "^dropout=1.5"),
        (lambda: DepthNoise(lateral=-1), "^lateral=-1"),
        (lambda: DepthNoise(camera="head"), "wrist or overhead"),
        (lambda: DelayObservation(-1), "^steps=-1"),
        (lambda: DelayObservation(1, names=[]), "at least one key"),
        (lambda: DelayObservation(1, names="mask"), "give a list"),
        (lambda: CameraPoseError(rotation=math.tau), "^rotation="),
        (lambda: JitterPoints(-0.1), "^sigma=-0.1"),
        (lambda: DropPoints(part="cube"), "ball or half_space"),
        (lambda: DropPoints(occluded=2), "^occluded=2"),
        (lambda: JitterPoints()(AppendGripperPoints()(cloud())), "before AppendGripperPoints"),
    ],
)
def test_what_cannot_be_is_refused(make, told):
    with pytest.raises(ConfigError, match=told):
        make()
