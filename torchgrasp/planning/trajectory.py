"""Goal-set trajectory optimisation: paths to all goals at once, the worst given up while the rest improve.

Covariant gradient descent on smoothness and clearance (CHOMP, Zucker et al. 2013), batched over
goals; which goal is reached is settled by the optimisation (the idea of OMG-Planner, Wang et al. 2020).
"""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass

import numpy as np

from torchgrasp.errors import check_range, check_whole
from torchgrasp.planning.clearance import Clearance
from torchgrasp.sim.kinematics import JOINT_LOWER, JOINT_UPPER, Array


@dataclass(frozen=True)
class TrajectoryOptimizer:
    """The optimiser's numbers.

    Attributes:
        num_points: postures of a path between its two ends.
        iterations: at most.
        step: share of the way back to the straight path that smoothness takes in an iteration.
        clearance_weight: of the clearance's cost against a squared radian of detour.
        keep: share of the goals that goes on after each `prune_every` iterations.
        prune_every: iterations between two prunings.
    """

    num_points: int = 12
    iterations: int = 24
    step: float = 0.1
    clearance_weight: float = 2.0
    keep: float = 0.5
    prune_every: int = 6

    def __post_init__(self) -> None:
        for name, low in (("num_points", 1), ("iterations", 0), ("prune_every", 1)):
            check_whole(name, getattr(self, name), low)
        check_range("clearance_weight", self.clearance_weight, 0.0, np.inf)
        check_range("step", self.step, 0.0, 1.0)
        check_range("keep", self.keep, 0.0, 1.0, open_low=True)

    def optimize(
        self, clearance: Clearance, q: Array, goals: Array, toll: Array, *, deadline: float = np.inf
    ) -> tuple[np.ndarray, Array]:
        """Paths from q (7,) to goals (K, 7), the best first.

        Args:
            clearance: of the scene.
            q: posture to start from.
            goals: postures to end at.
            toll: (K,) cost of each goal in itself, in the unit of the path's (radians of length).
            deadline: reading of `time.perf_counter` at which the best so far is taken.

        Returns:
            Indices (L,) of the goals to which a clear path was found, the cheapest first, and the paths
            (L, num_points + 2, 7), both ends included.
        """
        alive = np.arange(len(goals))
        straight = _straight(q, goals, self.num_points)
        paths = straight.copy()
        for iteration in range(self.iterations + 1):
            cost, gradient = self._clearance(clearance, paths[alive])
            total = _length(paths[alive]) + toll[alive] + self.clearance_weight * cost
            clear = alive[cost == 0.0]
            settled = len(clear) and total[cost == 0.0].min() <= total.min()
            if settled or iteration == self.iterations or time.perf_counter() > deadline:
                break
            if iteration and iteration % self.prune_every == 0 and len(alive) > 2:
                kept = np.argsort(total, kind="stable")[: max(2, int(np.ceil(self.keep * len(alive))))]
                alive, gradient = alive[kept], gradient[kept]
            paths[alive] = self._improve(paths[alive], straight[alive], gradient)
        return self._ranked(clearance, alive, paths, toll)

    def _clearance(self, clearance: Clearance, paths: Array) -> tuple[Array, Array]:
        """Cost (K,) of the inner points and its gradient (K, N, 7)."""
        inner = paths[:, 1:-1]
        cost, gradient = clearance.cost(inner.reshape(-1, 7))
        return cost.reshape(inner.shape[:2]).sum(axis=-1), gradient.reshape(inner.shape)

    def _improve(self, paths: Array, straight: Array, gradient: Array) -> Array:
        """One covariant step: clearance bends the whole path, smoothness draws it straight again."""
        bend = _smoothing(self.num_points) @ gradient
        # A step moves no joint by more than 0.15 rad, however deep a sphere has sunk.
        size = self.clearance_weight * np.abs(bend).max(axis=(1, 2), keepdims=True)
        bend *= self.clearance_weight / np.maximum(1.0, size / 0.15)
        stretch = self.step * (paths[:, 1:-1] - straight[:, 1:-1]) * (size < 1e-9)
        out = paths.copy()
        out[:, 1:-1] = np.clip(paths[:, 1:-1] - bend - stretch, JOINT_LOWER, JOINT_UPPER)
        return out

    def _ranked(
        self, clearance: Clearance, alive: np.ndarray, paths: Array, toll: Array
    ) -> tuple[np.ndarray, Array]:
        """The clear ones among the paths, the cheapest first, proved half way between their points too."""
        dense = np.stack((paths[alive, :-1], (paths[alive, :-1] + paths[alive, 1:]) / 2), axis=2)
        dense = dense.reshape(len(alive), -1, 7)[:, 1:]
        nearest = clearance.distances(dense.reshape(-1, 7)).reshape(len(alive), -1)
        # An arm that touches where it stands may not get deeper.
        limit = min(0.0, float(clearance.distances(paths[:1, 0])[0]) - 1e-3)
        clear = alive[(nearest > limit).all(axis=-1)]
        order = np.argsort(_length(paths[clear]) + toll[clear], kind="stable")
        return clear[order], paths[clear[order]]


def _straight(q: Array, goals: Array, num_points: int) -> Array:
    """(K, num_points + 2, 7) straight joint paths."""
    share = np.linspace(0.0, 1.0, num_points + 2)[:, None]
    return q + share * (goals[:, None, :] - q)


def _length(paths: Array) -> Array:
    """(K,) radians of the paths (K, N, 7) in joint space."""
    return np.linalg.norm(np.diff(paths, axis=1), axis=-1).sum(axis=-1)


@functools.cache
def _smoothing(num_points: int) -> Array:
    """(N, N) inverse of the metric of squared first differences, scaled to 1 at its largest."""
    metric = 2.0 * np.eye(num_points) - np.eye(num_points, k=1) - np.eye(num_points, k=-1)
    inverse = np.linalg.inv(metric)
    return inverse / inverse.max()
