"""The planner of Sec. 3.3: a goal set, trajectory optimisation to a standoff, a straight approach."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from torchgrasp.errors import ConfigError, check_range
from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.clearance import Clearance
from torchgrasp.planning.contact import arm_is_free, hand_is_free, starts_inside
from torchgrasp.planning.driven import drive_along
from torchgrasp.planning.goals import GoalChoice
from torchgrasp.planning.pacing import pace
from torchgrasp.planning.plan import Plan, Planner, PlanStatus, steps_to_arrive
from torchgrasp.planning.trajectory import TrajectoryOptimizer
from torchgrasp.sim import kinematics, tracking
from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.reach import ReachableGrasps

# Metres of standoff for each step left: late labels stay small.
_RETREAT = 0.012


@dataclass(frozen=True)
class _Goals:
    """Postures that end in a grasp by a straight approach.

    Attributes:
        row: (K,) of the grasp in the goal set.
        toll: (K,) radians that the grasp costs in itself.
        approach: (K, A + 1, 7) from the standoff to the grasp.
    """

    row: np.ndarray
    toll: Array
    approach: Array


@dataclass(frozen=True)
class TrajectoryPlanner(Planner):
    """Optimises joint paths to a set of grasps at once and takes the first that proves clear.

    Attributes:
        choice: which grasps are goals.
        optimizer: of the paths from the start to the standoffs.
        standoff: metres before the grasp from which on the hand goes straight (8 cm in the paper).
        approach_points: postures on the straight part.
        postures: so many of a grasp's postures over the arm's null space, the nearest to where it stands.
        num_goals: so many postures, the cheapest that are clear, are optimised at once.
        toll: radians of joint path that a metre of `choice`'s cost is worth.
        arrive: share of the horizon after which the hand is at the grasp, as the funnel's.
        num_steps: ``fixed`` spreads the path over the steps left; ``free`` takes as few as the arm's
            speed and the actions' bounds allow.
        budget: seconds after which no new path is tried; a plan that runs into it is not repeatable.
        control_period: seconds of a control step.
    """

    choice: GoalChoice = field(default_factory=lambda: GoalChoice(max_reached=16))
    optimizer: TrajectoryOptimizer = field(default_factory=TrajectoryOptimizer)
    standoff: float = 0.08
    approach_points: int = 4
    postures: int = 2
    num_goals: int = 6
    toll: float = 4.0
    arrive: float = 0.85
    num_steps: Literal["fixed", "free"] = "fixed"
    budget: float = 2.0
    control_period: float = 0.15

    def __post_init__(self) -> None:
        check_range("trajectory_planner.standoff", self.standoff, 0.0, 0.3)
        check_range("trajectory_planner.arrive", self.arrive, 0.0, 1.0, open_low=True)
        check_range("trajectory_planner.budget", self.budget, 0.0, np.inf)
        for name in ("approach_points", "postures", "num_goals"):
            check_range(f"trajectory_planner.{name}", getattr(self, name), 1, np.inf)
        if self.num_steps not in ("fixed", "free"):
            raise ConfigError(f"trajectory_planner.num_steps={self.num_steps!r}: give fixed or free.")

    def plan(
        self,
        target: GraspObject,
        T_base_object: Array,
        q: Array,
        steps_left: int,
        horizon: int,
        *,
        pursued: int = -1,
    ) -> Plan:
        """See `Planner.plan`."""
        started = time.perf_counter()
        # A late hand may take the steps that are kept in reserve, a free one as many as it needs.
        steps, at_most = steps_to_arrive(steps_left, horizon, self.arrive), steps_left
        if self.num_steps == "free":
            steps, at_most = 1, None
        found = self._search(target, T_base_object, q, (steps, at_most), started, pursued)
        return Plan(*found, seconds=time.perf_counter() - started)

    def _search(
        self,
        target: GraspObject,
        T_base_object: Array,
        q: Array,
        limits: tuple[int, int | None],
        started: float,
        pursued: int,
    ) -> tuple:
        """The arguments of the plan but for its time."""
        steps, at_most = limits
        status, grasps = self.choice.choose(target, T_base_object, q, pursued)
        if status is not PlanStatus.OK:
            return (status,)
        clearance = Clearance.of(target, T_base_object)
        if starts_inside(target, T_base_object, q, clearance):
            return (PlanStatus.START,)
        penalty = self.choice.cost(target, grasps, pursued)
        goals = self._solve(grasps, penalty, q, clearance, at_most)
        hurried = False
        for first in range(0, len(goals.row), self.num_goals):
            if time.perf_counter() - started > self.budget:
                return (PlanStatus.TIME,)
            batch = slice(first, first + self.num_goals)
            order, paths = self.optimizer.optimize(
                clearance,
                q,
                goals.approach[batch, 0],
                goals.toll[batch],
                deadline=started + self.budget,
            )
            for goal, path in zip(first + order, paths, strict=True):
                way = np.concatenate((path, goals.approach[goal, 1:]))
                paced = pace(way, steps, self.control_period, at_most=at_most)
                hurried |= paced is None
                proved = None if paced is None else self._prove(target, T_base_object, paced, clearance)
                if proved is not None:
                    return PlanStatus.OK, grasps, penalty, int(goals.row[goal]), *proved
        return (PlanStatus.STEPS if hurried else PlanStatus.BLOCKED,)

    def _solve(
        self, grasps: ReachableGrasps, cost: Array, q: Array, clearance: Clearance, at_most: int | None
    ) -> _Goals:
        """Postures of the nearest grasps whose straight approach the arm can follow clear of things."""
        row, postures = [], []
        for number, pose in enumerate(grasps.T_base_ee):
            found = kinematics.sample_postures(pose, q)[: self.postures]
            row += [number] * len(found)
            postures.append(found)
        rows = np.array(row, dtype=np.int64)
        approach, followed = self._retreat(grasps.T_base_ee[rows], np.concatenate(postures), at_most)
        apart = clearance.distances(approach[:, 0])
        apart = np.minimum(apart, clearance.distances(approach[:, -1], hand=False))
        good = followed & (apart > 0.0)
        rows, approach = rows[good], approach[good]
        toll = self.toll * cost[rows]
        order = np.argsort(toll + np.linalg.norm(approach[:, 0] - q, axis=-1), kind="stable")
        return _Goals(rows[order], toll[order], approach[order])

    def _retreat(self, T_base_goals: Array, q: Array, at_most: int | None) -> tuple[Array, np.ndarray]:
        """Joint paths (K, A + 1, 7) from the standoffs to the goals, and (K,) whether the arm can follow."""
        # A late hand has no steps for the whole way back and in again.
        standoff = self.standoff if at_most is None else min(self.standoff, _RETREAT * at_most)
        path = np.empty((len(q), self.approach_points + 1, 7))
        path[:, -1], followed = q, np.ones(len(q), dtype=bool)
        for point in range(1, self.approach_points + 1):
            pose = T_base_goals.copy()
            pose[:, :3, 3] -= standoff * point / self.approach_points * pose[:, :3, 2]
            path[:, -1 - point], error = tracking.track_pose(path[:, -point], pose, tolerance=1e-4)
            followed &= error < 1e-3
        return path, followed

    def _prove(
        self, target: GraspObject, T_base_object: Array, path: Array, clearance: Clearance
    ) -> tuple[Array, Array] | None:
        """The path as the hand's controller will drive it, where it arrives and nothing is touched.

        A controller of hand poses finds its own postures, so that its arm may stand otherwise than the
        optimiser's on the same poses of the hand.
        """
        ways = kinematics.forward_kinematics(path)
        driven = drive_along(path[0], ways)
        if driven is None or not hand_is_free(target, T_base_object, ways[None])[0]:
            return None
        return (driven, ways) if arm_is_free(clearance, driven[None])[0] else None
