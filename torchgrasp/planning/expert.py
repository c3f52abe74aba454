"""The expert as a policy: labels for any state, by reading what the environment knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.geometry import GOAL_SIZE, invert_pose, pose_to_goal
from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.planner import GraspPlanner, Plan, PlanStatus, pose_distances
from torchgrasp.sim.control import ActionSpace, EeDelta
from torchgrasp.sim.kinematics import Array

# An object that moved further than this since its plan was made is planned for again.
_MOVED, _TURNED = 0.02, 0.25


@dataclass
class _Pursuit:
    """What the expert remembers of one world: its episode, the plan for it, the grasp pursued."""

    episode: tuple[int, int]
    T_base_object: Array
    plan: Plan
    steps_left: int
    chosen: int = -1

    def goes_on(self, episode: tuple[int, int], T_base_object: Array, steps_left: int) -> bool:
        """Whether the plan still holds: time ran down in the same episode and the object lies still."""
        same = self.episode == episode and steps_left <= self.steps_left
        return same and not _has_moved(self.T_base_object, T_base_object)


class ExpertPolicy(TensorDictModuleBase):
    """Writes the expert's action and goal for every world of a batch (Sec. 3.5, D_dagger).

    The goal is the grasp nearest to the hand by L_POSE among those that the planner found; the one
    pursued is kept until another is nearer by `loyalty`, so that neighbouring states get neighbouring
    labels. States off the expert's own path are welcome. Where there is no grasp to be had,
    HAS_EXPERT and HAS_GOAL are false, both labels are zero, and PLAN_STATUS tells why.

    Batch elements are told apart by their place in the batch, and a new episode by EPISODE or by a
    clock that went back: use one policy for one batch of worlds.

    Args:
        objects: the environment's objects, which OBJECT_ID counts in.
        horizon: the environment's, T.
        planner: how grasps are chosen and approached.
        action_space: the environment's, in which labels are given.
        loyalty: metres of L_POSE by which another grasp must be nearer.
        execute: also write the label as ACTION; False where another policy acts.
    """

    def __init__(
        self,
        objects: Sequence[GraspObject],
        *,
        horizon: int,
        planner: GraspPlanner | None = None,
        action_space: ActionSpace | None = None,
        loyalty: float = 0.01,
        execute: bool = True,
    ) -> None:
        super().__init__()
        self.objects = objects
        self.horizon = horizon
        self.planner = planner or GraspPlanner()
        self.actions = action_space or EeDelta()
        self.loyalty = loyalty
        self.in_keys = [
            keys.T_BASE_EE,
            keys.T_BASE_OBJECT,
            keys.OBJECT_ID,
            keys.EPISODE,
            keys.JOINTS,
            keys.TIME_LEFT,
        ]
        labels = [keys.EXPERT_ACTION, keys.HAS_EXPERT, keys.GOAL, keys.HAS_GOAL, keys.PLAN_STATUS]
        self.out_keys = [*labels, keys.ACTION] if execute else labels  # pyright: ignore
        self.execute = execute
        self._pursuits: dict[int, _Pursuit] = {}

    @property
    def reasons(self) -> list[PlanStatus]:
        """For each world of the last batch whether there is a plan, or why not."""
        return [self._pursuits[i].plan.status for i in range(len(self._pursuits))]

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the labels; every input is (*, ...) as the environment gives it."""
        batch = tensordict.batch_size
        n = batch.numel()
        state = {
            key: tensordict.get(key).reshape(n, *tensordict.get(key).shape[len(batch) :])
            for key in self.in_keys
        }
        T_base_ee = state[keys.T_BASE_EE].double().cpu().numpy()
        T_base_object = state[keys.T_BASE_OBJECT].double().cpu().numpy()
        q = state[keys.JOINTS].double().cpu().numpy()[:, :7]
        steps_left = np.maximum(np.rint(state[keys.TIME_LEFT].cpu().numpy()[:, 0] * self.horizon), 1.0)
        identity = torch.cat((state[keys.OBJECT_ID], state[keys.EPISODE]), dim=-1).tolist()

        goals, has_goal = T_base_ee.copy(), np.zeros(n, dtype=bool)
        for i in range(n):
            goal = self._pursue(
                i, tuple(identity[i]), T_base_ee[i], T_base_object[i], q[i], int(steps_left[i])
            )
            if goal is not None:
                goals[i], has_goal[i] = goal, True
        target = self.planner.funnel.next_pose(T_base_ee, goals, steps_left, self.horizon)
        action = self.actions.action_towards(q, T_base_ee, target)
        return self._write(tensordict, T_base_ee, action, goals, has_goal)

    def _pursue(
        self,
        i: int,
        episode: tuple[int, int],
        T_base_ee: Array,
        T_base_object: Array,
        q: Array,
        steps_left: int,
    ) -> Array | None:
        """The (4, 4) grasp that world i goes for, None where there is none."""
        pursuit = self._pursuits.get(i)
        if pursuit is None or not pursuit.goes_on(episode, T_base_object, steps_left):
            plan = self.planner.plan(self.objects[episode[0]], T_base_object, q, steps_left, self.horizon)
            pursuit = self._pursuits[i] = _Pursuit(episode, T_base_object, plan, steps_left)
        pursuit.steps_left = steps_left
        if not pursuit.plan.ok:
            return None
        grasps = T_base_object @ self.objects[episode[0]].grasps[pursuit.plan.grasps.index].astype(np.float64)
        cost = pose_distances(T_base_ee, grasps) + pursuit.plan.penalty
        if pursuit.chosen >= 0:
            cost[pursuit.chosen] -= self.loyalty
        pursuit.chosen = int(np.argmin(cost))
        return grasps[pursuit.chosen]

    def _write(
        self, tensordict: TensorDictBase, T_base_ee: Array, label: Array, goals: Array, has_goal: np.ndarray
    ) -> TensorDictBase:
        batch, device = tensordict.batch_size, tensordict.device
        T_ee_base = invert_pose(torch.from_numpy(T_base_ee))
        valid = torch.from_numpy(has_goal)[:, None]
        action = torch.from_numpy(label) * valid
        goal = pose_to_goal(T_ee_base @ torch.from_numpy(goals)) * valid
        action = action.float().reshape(*batch, self.actions.size).to(device)
        valid = valid.reshape(*batch, 1).to(device)
        tensordict.set(keys.EXPERT_ACTION, action)
        tensordict.set(keys.HAS_EXPERT, valid)
        tensordict.set(keys.GOAL, goal.float().reshape(*batch, GOAL_SIZE).to(device))
        tensordict.set(keys.HAS_GOAL, valid.clone())
        status = torch.tensor([[reason.number] for reason in self.reasons])
        tensordict.set(keys.PLAN_STATUS, status.reshape(*batch, 1).to(device))
        if self.execute:
            tensordict.set(keys.ACTION, action.clone())
        return tensordict


def _has_moved(before: Array, after: Array) -> bool:
    moved = np.abs(after[:3, 3] - before[:3, 3]).max() > _MOVED
    return bool(moved or np.abs(after[:3, :3] - before[:3, :3]).max() > _TURNED)
