"""The planner of Sec. 3.3: a goal set, trajectory optimisation to a standoff, a straight approach."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from torchgrasp.errors import ConfigError, check_range, check_whole
from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.clearance import Clearance
from torchgrasp.planning.contact import arm_is_free, hand_is_free, starts_inside
from torchgrasp.planning.goals import GoalChoice
from torchgrasp.planning.joint_path import drive_along
from torchgrasp.planning.pacing import pace
from torchgrasp.planning.plan import Plan, PlanStatus
from torchgrasp.planning.planner import Planner, Query
from torchgrasp.planning.trajectory import TrajectoryOptimizer
from torchgrasp.sim import kinematics, tracking
from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.reach import ReachableGrasps

# Metres of standoff for each step left: late labels stay small.
_RETREAT = 0.012


@dataclass(frozen=True)
class _Goals:
    """Postures at grasps, the cheapest first.

    Attributes:
        row: (K,) of the grasp in the goal set.
        toll: (K,) radians that the grasp costs in itself.
        q: (K, 7) the postures.
    """

    row: np.ndarray
    toll: Array
    q: Array

    def of(self, row: int) -> _Goals:
        """Those of one grasp."""
        mine = self.row == row
        return _Goals(self.row[mine], self.toll[mine], self.q[mine])


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
        budget: seconds after which no new path is tried; a plan that is cut short by it is not repeatable.
    """

    choice: GoalChoice = field(default_factory=GoalChoice)
    optimizer: TrajectoryOptimizer = field(default_factory=TrajectoryOptimizer)
    standoff: float = 0.08
    approach_points: int = 4
    postures: int = 2
    num_goals: int = 6
    toll: float = 4.0
    arrive: float = 0.85
    num_steps: Literal["fixed", "free"] = "fixed"
    budget: float = np.inf

    def __post_init__(self) -> None:
        check_range("standoff", self.standoff, 0.0, 0.3)
        check_range("arrive", self.arrive, 0.0, 1.0, open_low=True)
        for name in ("budget", "toll"):
            check_range(name, getattr(self, name), 0.0, np.inf)
        for name in ("approach_points", "postures", "num_goals"):
            check_whole(name, getattr(self, name), 1)
        if self.num_steps not in ("fixed", "free"):
            raise ConfigError(f"num_steps={self.num_steps!r}: give fixed or free.")

    def find_way(self, query: Query, grasps: ReachableGrasps) -> Plan:
        """See `Planner.find_way`."""
        target, clearance = query.target, Clearance.of(query.target, query.T_base_object)
        if starts_inside(target, query.T_base_object, query.q, clearance):
            return Plan(PlanStatus.START)
        # A late hand may take the steps that are kept in reserve.
        steps = query.steps_to_arrive(self.arrive) if self.num_steps == "fixed" else 1
        hurried = False
        goals = self._solve(query, grasps)
        for standoff, part in self._attempts(query, grasps, goals):
            for row, way in self._optimized(query, grasps, part, clearance, standoff):
                path = pace(way, steps, query.control_period, at_most=query.steps_left)
                hurried |= path is None
                proved = None if path is None else self._prove(target, query.T_base_object, path, clearance)
                if proved is not None:
                    penalty = self.choice.cost(target, grasps)
                    return Plan(PlanStatus.OK, grasps, penalty, row, *proved)
        if time.perf_counter() - query.started > self.budget:
            return Plan(PlanStatus.TIME)
        return Plan(PlanStatus.STEPS if hurried else PlanStatus.BLOCKED)

    def _attempts(
        self, query: Query, grasps: ReachableGrasps, goals: _Goals
    ) -> Iterator[tuple[float, _Goals]]:
        """Standoffs and goals to try in turn, until a way is found."""
        standoff = min(self.standoff, _RETREAT * query.steps_left)
        if grasps.index[0] == query.pursued:
            # Still the cheapest: most often its way is clear, and the others need not be asked.
            yield standoff, goals.of(0)
        yield standoff, goals
        if standoff < self.standoff:
            # A late hand may have no steps for the whole way back and in again.
            yield standoff / 4, goals

    def _solve(self, query: Query, grasps: ReachableGrasps) -> _Goals:
        """Postures of the grasps, ranked by their toll and the straight way to them in joint space."""
        q, cost = query.q, self.choice.cost(query.target, grasps, query.pursued)
        found = [postures[: self.postures] for postures in grasps.postures]
        rows = np.repeat(np.arange(len(grasps)), [len(postures) for postures in found])
        postures, toll = np.concatenate(found), self.toll * cost[rows]
        order = np.argsort(toll + np.linalg.norm(postures - q, axis=-1), kind="stable")
        return _Goals(rows[order], toll[order], postures[order])

    def _optimized(
        self,
        query: Query,
        grasps: ReachableGrasps,
        goals: _Goals,
        clearance: Clearance,
        standoff: float,
    ) -> Iterator[tuple[int, Array]]:
        """Rows of grasps and clear ways (N, 7) to them, batch by batch until the budget is spent."""
        deadline = query.started + self.budget
        for first in range(0, len(goals.row), self.num_goals):
            if time.perf_counter() > deadline:
                return
            batch = slice(first, first + self.num_goals)
            rows, toll = goals.row[batch], goals.toll[batch]
            approach, clear = self._approach(grasps.T_base_ee[rows], goals.q[batch], clearance, standoff)
            rows, toll, approach = rows[clear], toll[clear], approach[clear]
            if not len(rows):
                continue
            order, paths = self.optimizer.optimize(
                clearance, query.q, approach[:, 0], toll, deadline=deadline
            )
            for goal, path in zip(order, paths, strict=True):
                yield int(rows[goal]), np.concatenate((path, approach[goal, 1:]))

    def _approach(
        self, T_base_goals: Array, q: Array, clearance: Clearance, standoff: float
    ) -> tuple[Array, np.ndarray]:
        """Joint paths (K, A + 1, 7) from the standoffs to the goals, and (K,) whether they are clear."""
        path = np.empty((len(q), self.approach_points + 1, 7))
        path[:, -1], clear = q, np.ones(len(q), dtype=bool)
        for point in range(1, self.approach_points + 1):
            pose = T_base_goals.copy()
            pose[:, :3, 3] -= standoff * point / self.approach_points * pose[:, :3, 2]
            path[:, -1 - point], error = tracking.track_pose(path[:, -point], pose, tolerance=1e-4)
            clear &= error < 1e-3
        clear &= clearance.distances(path[:, 0]) > 0.0
        return path, clear & (clearance.distances(path[:, -1], hand=False) > 0.0)

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
