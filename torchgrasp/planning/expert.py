"""The expert as a policy: labels for any state, by reading what the environment knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import GOAL_SIZE, NO_GOAL, invert_pose, pose_to_goal
from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.funnel_planner import FunnelPlanner
from torchgrasp.planning.goals import pose_distances
from torchgrasp.planning.law import Course, Law, PathFollower
from torchgrasp.planning.plan import Plan, PlanStatus
from torchgrasp.planning.planner import Planner
from torchgrasp.planning.trajectory_planner import TrajectoryPlanner
from torchgrasp.planning.world_states import STATE_KEYS, WorldStates
from torchgrasp.sim.control import ActionSpace, EeDelta
from torchgrasp.sim.kinematics import Array

# An object that moved further than this since its plan was made is planned for again.
_MOVED, _TURNED = 0.02, 0.25
# What may be otherwise a few steps on, asked again after so many; steps_left that no episode has.
_MAY_PASS = (PlanStatus.BLOCKED, PlanStatus.STEPS, PlanStatus.TIME, PlanStatus.START)
_PATIENCE, _NEVER = 3, 1_000_000
# Where another planner may still find a way.
_HOPEFUL = (PlanStatus.BLOCKED, PlanStatus.STEPS)


class _Guide(NamedTuple):
    """A planner, and the law that its plans are followed by."""

    planner: Planner
    law: Law


@dataclass
class _Pursuit:
    """What the expert remembers of one world: its episode, the plan for it, the grasp pursued."""

    episode: tuple[int, int]
    T_base_object: Array
    planned_for: Array
    plan: Plan
    guide: _Guide
    planned_at: int
    steps_left: int
    chosen: int = -1
    failed_at: int = _NEVER

    def is_of(self, episode: tuple[int, int], steps_left: int) -> bool:
        """Whether it is of this episode, in which time ran down since."""
        return self.episode == episode and steps_left <= self.steps_left

    @property
    def pursued(self) -> int:
        """Row of the grasp gone for in the object's grasp set, -1 without one."""
        row = self.plan.chosen if self.chosen < 0 else self.chosen
        return int(self.plan.grasps.index[row]) if self.plan.ok and row >= 0 else -1

    def goes_on(self, episode: tuple[int, int], T_base_object: Array, steps_left: int) -> bool:
        """Whether the plan still holds: it is of this episode and the object lies still."""
        return self.is_of(episode, steps_left) and not _has_moved(self.T_base_object, T_base_object)

    def course(self, T_base_goal: Array, T_base_object: Array) -> Course:
        """What the law is told."""
        shift = T_base_object @ np.linalg.inv(self.planned_for)
        return Course(self.plan, T_base_goal, self.planned_at - self.steps_left, shift)


class ExpertPolicy(TensorDictModuleBase):
    """Writes the expert's action and goal for every world of a batch (Sec. 3.5, D_dagger).

    Along a path the goal is the grasp that it ends at, and a hand that was led astray gets a new path. A
    law that may go for any grasp goes for the nearest by L_POSE among those that the planner found; the
    one pursued is kept until another is nearer by `GoalChoice.loyalty`. Where there is no grasp to be had,
    HAS_EXPERT and HAS_GOAL are false, both labels are zero, and PLAN_STATUS tells why.

    Worlds are told apart by WORLD, wherever in the batch they stand, and a new episode by EPISODE or by
    a clock that went back.

    Args:
        objects: the environment's objects, which OBJECT_ID counts in.
        horizon: the environment's, T.
        planner: how grasps are chosen and the way to them is proved; `TrajectoryPlanner` by default.
        law: how the hand goes on from any state; by default the funnel of a `FunnelPlanner`, along the
            path of any other.
        fallback: asked where the planner finds no way, above all for a learner that is late; its plans are
            followed by the law that is its own. By default a `FunnelPlanner` where no planner is given.
        action_space: the environment's, in which labels are given.
        execute: also write the label as ACTION; False where another policy acts.
    """

    def __init__(
        self,
        objects: Sequence[GraspObject],
        *,
        horizon: int,
        planner: Planner | None = None,
        law: Law | None = None,
        fallback: Planner | None = None,
        action_space: ActionSpace | None = None,
        execute: bool = True,
    ) -> None:
        super().__init__()
        self.objects = objects
        self.horizon = horizon
        self.planner = planner or TrajectoryPlanner()
        self.law = law or _own_law(self.planner)
        if fallback is None and planner is None:
            fallback = FunnelPlanner()
        self._guides = [_Guide(self.planner, self.law)]
        if fallback is not None:
            self._guides.append(_Guide(fallback, _own_law(fallback)))
        if not self.law.any_goal and not self.planner.gives_path:
            raise ConfigError("law follows a path, but the planner has none: give it prove=True.")
        self.actions = action_space or EeDelta()
        self.in_keys = list(STATE_KEYS)
        labels = [keys.EXPERT_ACTION, keys.HAS_EXPERT, keys.GOAL, keys.HAS_GOAL, keys.PLAN_STATUS]
        self.out_keys = [*labels, keys.ACTION] if execute else labels  # pyright: ignore
        self.execute = execute
        self._pursuits: dict[int, _Pursuit] = {}
        self._reasons: list[PlanStatus] = []

    @property
    def reasons(self) -> list[PlanStatus]:
        """For each world of the last batch whether there is a plan, or why not."""
        return self._reasons

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the labels; every input is (*, ...) as the environment gives it."""
        states = WorldStates.read(tensordict, self.horizon)
        T_base_ee, steps_left = states.T_base_ee, states.steps_left
        courses, guides, self._reasons = [], [], []
        for row, world in enumerate(states.worlds):
            courses.append(self._pursue(states, row))
            guides.append(self._pursuits[world].guide)
            self._reasons.append(self._pursuits[world].plan.status)
        target, goals = T_base_ee.copy(), T_base_ee.copy()
        has_goal = np.array([course is not None for course in courses])
        for guide in self._guides:
            led = {
                row: course
                for row, course in enumerate(courses)
                if course is not None and guides[row] is guide
            }
            if led:
                rows, held = list(led), list(led.values())
                goals[rows] = [course.T_base_goal for course in held]
                target[rows] = guide.law.steer(T_base_ee[rows], held, steps_left[rows], self.horizon)
        action = self.actions.action_towards(states.q, T_base_ee, target)
        return self._write(tensordict, T_base_ee, action, goals, has_goal)

    def _pursue(self, states: WorldStates, row: int) -> Course | None:
        """What a row's world goes for, None where there is no grasp to be had."""
        world, episode, steps_left = states.worlds[row], states.episodes[row], int(states.steps_left[row])
        T_base_ee, T_base_object = states.T_base_ee[row], states.T_base_object[row]
        target, pursuit = self.objects[episode[0]], self._pursuits.get(world)
        if pursuit is not None and pursuit.goes_on(episode, T_base_object, steps_left):
            pursuit.steps_left = steps_left
            course = self._choose(pursuit, target, T_base_ee, T_base_object)
            content = course is not None and not pursuit.guide.law.is_lost(T_base_ee, course)
            if content or pursuit.failed_at - steps_left < _PATIENCE:
                return course
        known = pursuit is not None and pursuit.is_of(episode, steps_left)
        pursued = pursuit.pursued if pursuit is not None and known else -1
        plan, guide = self._plan(target, T_base_object, states.q[row], steps_left, pursued)
        if not plan.ok and pursuit is not None and known and pursuit.plan.ok:
            # Late in an episode there is often no new way: better the grasps known than none.
            pursuit.T_base_object = T_base_object
            pursuit.steps_left = pursuit.failed_at = steps_left
            return self._choose(pursuit, target, T_base_ee, T_base_object)
        pursuit = self._pursuits[world] = _Pursuit(
            episode, T_base_object, T_base_object, plan, guide, steps_left, steps_left
        )
        if not plan.ok:
            pursuit.failed_at = steps_left if plan.status in _MAY_PASS else -_NEVER
        return self._choose(pursuit, target, T_base_ee, T_base_object)

    def _plan(
        self, target: GraspObject, T_base_object: Array, q: Array, steps_left: int, pursued: int
    ) -> tuple[Plan, _Guide]:
        """The planner's plan, or the fallback's where that has none, and the guide that made it."""
        scene = (target, T_base_object, q, steps_left, self.horizon)
        options = {"pursued": pursued, "control_period": self.actions.control_period}
        own, *others = self._guides
        plan = own.planner.plan(*scene, **options)
        for guide in others if plan.status in _HOPEFUL else ():
            other = guide.planner.plan(*scene, **options)
            if other.ok:
                return other, guide
        return plan, own

    def _choose(
        self, pursuit: _Pursuit, target: GraspObject, T_base_ee: Array, T_base_object: Array
    ) -> Course | None:
        """The planned grasp, or the nearest where the law is free to go for any."""
        plan = pursuit.plan
        if not plan.ok:
            return None
        grasps = T_base_object @ target.grasps[plan.grasps.index].astype(np.float64)
        if not pursuit.guide.law.any_goal:
            return pursuit.course(grasps[plan.chosen], T_base_object)
        cost = pose_distances(T_base_ee, grasps) + plan.penalty
        if pursuit.chosen >= 0:
            cost[pursuit.chosen] -= pursuit.guide.planner.choice.loyalty
        pursuit.chosen = int(np.argmin(cost))
        return pursuit.course(grasps[pursuit.chosen], T_base_object)

    def _write(
        self, tensordict: TensorDictBase, T_base_ee: Array, label: Array, goals: Array, has_goal: np.ndarray
    ) -> TensorDictBase:
        batch, device = tensordict.batch_size, tensordict.device
        T_ee_base = invert_pose(torch.from_numpy(T_base_ee))
        valid = torch.from_numpy(has_goal)[:, None]
        action = torch.from_numpy(label) * valid
        goal = pose_to_goal(T_ee_base @ torch.from_numpy(goals))
        goal = torch.where(valid, goal, goal.new_tensor(NO_GOAL))
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


def _own_law(planner: Planner) -> Law:
    """The law that a planner's plans are made for."""
    return planner.funnel if isinstance(planner, FunnelPlanner) else PathFollower()


def _has_moved(before: Array, after: Array) -> bool:
    moved = np.abs(after[:3, 3] - before[:3, 3]).max() > _MOVED
    return bool(moved or np.abs(after[:3, :3] - before[:3, :3]).max() > _TURNED)
