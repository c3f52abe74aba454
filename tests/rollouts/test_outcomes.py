"""Why episodes fail, by physics."""

from collections.abc import Sequence

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from torchgrasp.envs import GraspEnv
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import NO_PLANNER, PlanStatus
from torchgrasp.rollouts.episode_pool import SerialPool
from torchgrasp.rollouts.outcomes import failure_cause
from torchgrasp.sim import CameraIntrinsics, RaycastCamera

OBJECTS = ProceduralObjects("train", num_objects=1, num_grasps=100)


def run_always(*action: float) -> list[str | None]:
    """Causes of two episodes of twenty steps of one action."""
    return run([action] * 20)


def run(actions: Sequence[tuple[float, ...]]) -> list[str | None]:
    """Causes of two episodes of twenty steps of these actions."""
    camera = RaycastCamera(CameraIntrinsics(12, 12))
    following = iter(actions)
    policy = TensorDictModule(
        lambda time_left: torch.tensor(next(following)).expand(*time_left.shape[:-1], -1),
        ["time_left"],
        ["action"],
    )
    with SerialPool(
        {"test": lambda: GraspEnv(2, objects=OBJECTS, camera=camera, horizon=20, seed=0)}
    ) as pool:
        (episodes,) = pool.run("test", policy, [0])
    return [episode.failure for episode in episodes]


def test_a_hand_that_stands_closes_on_nothing():
    assert run_always(0.0, 0.0, 0.0, 0.0, 0.0, 0.0) == 2 * ["the fingers closed on nothing"]


def test_an_arm_that_is_sent_beyond_its_reach_is_told_from_one_that_misses():
    """Backwards from the object, 6 cm a step: 120 cm are more than its reach."""
    assert run_always(0.0, 0.0, -0.06, 0.0, 0.0, 0.0) == 2 * ["the arm could not follow"]


def test_an_arm_that_is_sent_further_than_an_action_may_is_not_stopped():
    """10 cm to and fro, of which the environment allows 6."""
    there, back = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0), (-0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert run([there, back] * 10) == 2 * ["the fingers closed on nothing"]


def test_a_hand_that_turns_away_has_lost_sight_of_the_object():
    """12 degrees a step for eight steps, then it stands."""
    turn, stand = (0.0, 0.0, 0.0, 0.21, 0.0, 0.0), (0.0,) * 6
    assert run([turn] * 8 + [stand] * 12) == 2 * ["the target was out of sight"]


def episode(**told: torch.Tensor) -> TensorDict:
    """Four steps that fail; the hand and the object stand."""
    poses = torch.eye(4).expand(4, 4, 4)
    after = {"reward": torch.zeros(4, 1), "T_base_object": poses, **told}
    steps = {"action": torch.zeros(4, 6), "T_base_ee": poses}
    if (status := after.pop("plan_status", None)) is not None:
        steps["plan_status"] = status
    return TensorDict({**steps, "next": after}, [4])


def views(*seen: bool) -> torch.Tensor:
    return torch.tensor(seen)[:, None, None].expand(-1, 2, 2)


@pytest.mark.parametrize(
    ("steps", "cause"),
    [
        (episode(camera={"mask": views(1, 0, 0, 0)}), "the target was out of sight"),
        (episode(camera={"mask": views(0, 1, 0, 0)}), "the fingers closed on nothing"),
        (
            episode(camera={"mask": views(0, 0, 0, 0)}, overhead={"mask": views(0, 0, 0, 1)}),
            "the fingers closed on nothing",
        ),
        (
            episode(
                camera={"mask": views(0, 0, 0, 0)},
                plan_status=torch.full((4, 1), PlanStatus.OK.number),
            ),
            "the fingers closed on nothing",
        ),
        (
            episode(camera={"mask": views(0, 0, 0, 0)}, plan_status=torch.full((4, 1), NO_PLANNER)),
            "the target was out of sight",
        ),
        (episode(), "the fingers closed on nothing"),
    ],
)
def test_who_looks_has_lost_the_target_where_no_last_view_of_any_camera_shows_it(steps, cause):
    assert failure_cause(steps, 0.0, unstable=False) == cause
