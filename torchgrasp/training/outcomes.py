"""Why an episode ended without the object in the hand."""

from __future__ import annotations

from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.planning import NO_PLANNER, PlanStatus

_EMPTY = 1e-3  # metres between pads that hold nothing


def failure_cause(steps: TensorDictBase, gap: float) -> str | None:
    """The cause in words, None for an episode that succeeded.

    Args:
        steps: (T,) the episode, with PLAN_STATUS where a planner acted; its last word counts.
        gap: metres between the finger pads after the attempt to lift.
    """
    if steps["next", "reward"].sum() > 0:
        return None
    status = steps.get(keys.PLAN_STATUS, None)
    told = [] if status is None else [number for number in status[:, 0].tolist() if number != NO_PLANNER]
    if told and told[-1] != PlanStatus.OK.number:
        return f"no plan: {list(PlanStatus)[told[-1]].reason}"
    height = float(steps["next", keys.T_BASE_OBJECT][-1, 2, 3])
    if height < 0.0:
        return "pushed off the table"
    return "the fingers closed on nothing" if gap < _EMPTY else "slipped out of the fingers"
