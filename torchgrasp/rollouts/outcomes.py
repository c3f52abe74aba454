"""Why an episode ended without the object in the hand."""

from __future__ import annotations

import roma
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.geometry import ACTION_BOUND, ACTION_SIZE, action_to_pose
from torchgrasp.planning import NO_PLANNER, PlanStatus

_EMPTY = 1e-3  # metres between pads that hold nothing
# The arm was stopped where this many steps ended that far, in metres, from where they were to end, or that
# much, in radians, from how the hand was to be turned: it gives way in its rotation first.
_STOPPED_STEPS, _STOPPED_SHORT, _STOPPED_TURN = 3, 0.02, 0.1
_UNSEEN_STEPS = 3  # so many last views without a pixel of the target mean that it was lost


def failure_cause(steps: TensorDictBase, gap: float, *, unstable: bool) -> str | None:
    """The cause in words, None for an episode that succeeded.

    Args:
        steps: (T,) the episode, all keys of the environment, with PLAN_STATUS where a planner acted; its last
            word counts.
        gap: metres between the finger pads after the attempt to lift.
        unstable: whether the physics became unstable.
    """
    if steps["next", "reward"].sum() > 0:
        return None
    if unstable:
        return "the physics became unstable"
    status = steps.get(keys.PLAN_STATUS, None)
    told = [] if status is None else [number for number in status[:, 0].tolist() if number != NO_PLANNER]
    if told and told[-1] != PlanStatus.OK.number:
        return f"no plan: {list(PlanStatus)[told[-1]].reason}"
    height = float(steps["next", keys.T_BASE_OBJECT][-1, 2, 3])
    if height < 0.0:
        return "pushed off the table"
    if gap >= _EMPTY:
        return "slipped out of the fingers"
    if _count_stopped(steps) >= _STOPPED_STEPS:
        return "the arm could not follow"
    looked = status is None or int(status[-1, 0]) == NO_PLANNER  # planners know without looking
    if looked and _has_lost_sight(steps):
        return "the target was out of sight"
    return "the fingers closed on nothing"


def _count_stopped(steps: TensorDictBase) -> int:
    """Steps (T,) that did not end where a relative hand pose sent them; none in other action spaces."""
    if steps[keys.ACTION].shape[-1] != ACTION_SIZE:
        return 0
    bound = steps[keys.ACTION].new_tensor(ACTION_BOUND)
    allowed = steps[keys.ACTION].clamp(-bound, bound)  # as the environment clips it
    sent = steps[keys.T_BASE_EE] @ action_to_pose(allowed)
    sent, came = sent[:-1], steps[keys.T_BASE_EE][1:]
    missed = (sent[:, :3, 3] - came[:, :3, 3]).norm(dim=-1)
    unturned = roma.rotmat_geodesic_distance(sent[:, :3, :3], came[:, :3, :3])
    return int(((missed > _STOPPED_SHORT) | (unturned > _STOPPED_TURN)).sum())


def _has_lost_sight(steps: TensorDictBase) -> bool:
    """Whether the target is in none of the last views of (T,) steps, of all cameras, as they are shown."""
    masks = [steps.get(("next", *key), None) for key in (keys.MASK, keys.OVERHEAD_MASK)]
    views = [mask[-_UNSEEN_STEPS:] for mask in masks if mask is not None]
    return bool(views) and not any(view.any() for view in views)
