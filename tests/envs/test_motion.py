"""Targets that move: how far, where, and what a held one does when it is grasped."""

import numpy as np
import pytest
import torch

from torchgrasp.envs import GraspEnv, HandoverTarget, JitterTarget, MixedTarget, StaticTarget
from torchgrasp.envs.motion import ROUTES, make_target_motion, moved
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import ExpertPolicy
from torchgrasp.sim import CameraIntrinsics, RaycastCamera

AREA = ((0.40, 0.65), (-0.25, 0.25))
OBJECTS = ProceduralObjects("train", num_objects=4, num_grasps=100, families=["box", "cylinder"])


def at_rest() -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = 0.5, 0.1, 0.05
    return pose


def make_env(motion, **options) -> GraspEnv:
    torch.set_num_threads(1)
    camera = RaycastCamera(CameraIntrinsics(4, 4))
    options = {"seed": 0} | options
    return GraspEnv(4, objects=OBJECTS, camera=camera, target_motion=motion, **options)


def rollout(env: GraspEnv):
    expert = ExpertPolicy(OBJECTS, horizon=env.horizon)
    return env.rollout(env.horizon, expert, break_when_any_done=False, break_when_all_done=True)


def test_a_static_target_makes_no_move():
    pose, moves, held = StaticTarget().present(np.random.default_rng(0), at_rest(), AREA)
    assert np.array_equal(pose, at_rest()) and len(moves) == 0 and not held


def test_a_jittering_target_moves_at_most_so_far_and_stays_in_the_area():
    largest = np.zeros(3)
    for seed in range(100):
        pose, moves, _ = JitterTarget().present(np.random.default_rng(seed), at_rest(), AREA)
        assert np.array_equal(pose, at_rest()) and moves.shape == (12, 3)
        places = pose[:2, 3] + np.cumsum(moves[:, :2], axis=0)
        assert np.all(places >= [0.40 - 1e-9, -0.25 - 1e-9]) and np.all(places <= [0.65 + 1e-9, 0.25 + 1e-9])
        largest = np.maximum(largest, np.abs(moves).max(0))
    assert largest == pytest.approx([0.03, 0.03, np.deg2rad(15)], rel=0.02)


@pytest.mark.parametrize(
    ("route", "first", "last"),
    [
        ("left", 0.2, 0.2),
        ("middle", 0, 0),
        ("right", -0.2, -0.2),
        ("left_to_right", 0.2, -0.2),
        ("right_to_left", -0.2, 0.2),
    ],
)
def test_a_handed_target_is_where_its_route_says(route, first, last):
    pose, moves, held = HandoverTarget(route=route).present(np.random.default_rng(0), at_rest(), AREA)
    assert held and pose[1, 3] == pytest.approx(first)
    assert pose[1, 3] + moves[:, 1].sum() == pytest.approx(last)
    assert 0.25 <= pose[2, 3] <= 0.40 and np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    assert not len(moves) or np.abs(moves[:, 1]).max() < 0.05


def test_random_routes_are_all_taken_and_tilts_are_bounded():
    sides, tilts = set(), []
    for seed in range(60):
        pose, moves, _ = HandoverTarget().present(np.random.default_rng(seed), at_rest(), AREA)
        sides.add((round(pose[1, 3], 3), round(float(moves[:, 1].sum()), 3) + 0.0))
        tilts.append(np.arccos(pose[2, 2]))
    assert len(sides) == len(ROUTES)
    assert 0.4 < max(tilts) <= 0.5 + 1e-9


def test_a_mixture_draws_each_motion_by_its_weight():
    drawn = [MixedTarget().present(np.random.default_rng(seed), at_rest(), AREA) for seed in range(200)]
    kinds = ["held" if each.held else "moving" if len(each.moves) else "static" for each in drawn]
    assert kinds.count("static") / 200 == pytest.approx(0.5, abs=0.1)
    assert kinds.count("moving") / 200 == pytest.approx(0.25, abs=0.1)
    assert kinds.count("held") / 200 == pytest.approx(0.25, abs=0.1)


@pytest.mark.parametrize("weights", [(1.0,), (0.0, 0.0, 0.0), (1.0, -1.0, 1.0)])
def test_a_mixture_refuses_weights_that_choose_nothing(weights):
    with pytest.raises(ConfigError, match="weights"):
        MixedTarget(weights=weights)


def test_in_a_mixture_the_held_alone_hang_in_the_air():
    env = make_env("mixed", horizon=2, seed=1)
    heights = {True: [], False: []}
    for episode in range(6):
        for world in range(4):
            scene = env.scene(world, episode)
            heights[scene.held].append(scene.T_base_object[2, 3])
    assert min(heights[True]) > 0.24 > 0.15 > max(heights[False])


def test_a_move_turns_an_object_about_itself():
    after = moved(at_rest(), np.array([0.01, -0.02, np.pi / 2]))
    assert after[:3, 3] == pytest.approx([0.51, 0.08, 0.05])
    assert after[:3, 0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


def test_the_world_moves_the_target_as_the_scene_says():
    env = make_env("jitter", horizon=5, seed=2)
    steps = env.rollout(5, lambda td: td.set("action", torch.zeros(4, 6)))
    for row in range(4):
        scene = env.scene(row, 0)
        places = scene.T_base_object[:2, 3] + np.cumsum(scene.moves[:5, :2], axis=0)
        seen = steps["next", "T_base_object"][row, :, :2, 3].numpy()
        assert seen == pytest.approx(places, abs=3e-3)


def test_a_held_target_stays_in_the_air_and_is_lifted_by_the_expert():
    env = make_env("handover", horizon=30, seed=1)
    steps = rollout(env)
    heights = steps["T_base_object"][:, :, 2, 3]
    assert torch.equal(heights, heights[:, :1].expand_as(heights))  # until the fingers have closed
    travel = (steps["T_base_object"][:, -1, 1, 3] - steps["T_base_object"][:, 0, 1, 3]).abs()
    moving = torch.tensor([len(env.scene(row, 0).moves) > 0 for row in range(4)])
    assert torch.allclose(travel, moving * 0.4, atol=1e-3)
    assert steps["next", "reward"].sum() >= 3


def test_a_held_target_that_nobody_grasps_falls():
    env = make_env(HandoverTarget(route="middle"), horizon=2)
    steps = env.rollout(2, lambda td: td.set("action", torch.zeros(4, 6)))
    assert steps["next", "reward"].sum() == 0
    final = env.worlds.T_base_object[:, 2, 3]
    assert np.all(final < steps["T_base_object"][:, 0, 2, 3].numpy() - 0.1)


def test_unknown_motions_are_refused():
    with pytest.raises(ConfigError, match="target_motion='dance'"):
        make_target_motion("dance")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="route"):
        HandoverTarget(route="up")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="translation"):
        JitterTarget(translation=-1.0)
    for options, word in (({"steps": 1.5}, "steps"), ({"z": 0.3}, "z=0.3"), ({"z": (-1.0, -0.9)}, "z")):
        with pytest.raises(ConfigError, match=word):
            HandoverTarget(**options)  # type: ignore[arg-type]
