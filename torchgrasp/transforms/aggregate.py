"""AggregatePoints: the state s_t, all views of the episode in today's hand frame (Sec. 6.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range
from torchgrasp.geometry import invert_pose, transform_points
from torchgrasp.transforms.base import PointTransform, flat_batch, pad_clouds

# Powers of alpha carry errors that must not add a point: 0.9**2 * 100 is 81.00000000000001 in floats.
_ROUNDING = 1e-9

_IN_KEYS = (keys.POINTS, keys.NUM_POINTS, keys.T_BASE_EE)
_OUT_KEYS = (keys.POINTS, keys.NUM_POINTS)


@dataclass
class _Union:
    """The views of one episode so far: (M, 3) points in the base frame and t, the number of views."""

    points: Tensor = field(default_factory=lambda: torch.empty(0, 3))
    views: int = 0


class AggregatePoints(PointTransform):
    """Joins the views of an episode: s_t = T_t(union of T_i^-1(X_i) for i <= t) (Sec. 6.2).

    Of the n_t points seen at t, m_t = ceil(alpha^t n_t) are drawn uniformly and kept in the base frame;
    POINTS then holds the union in the hand frame at t, and NUM_POINTS its size. In an environment each
    world's union begins anew at its reset. On a tensordict that is not an environment's, the last batch
    dimension is time, and a union begins anew after each ("next", "done").

    Args:
        alpha: share that the draw shrinks by at every step; 1 keeps every point.
        max_points: of the union; beyond it a uniform draw of the union is kept.
        seed: of the draws.
    """

    def __init__(self, alpha: float = 0.95, *, max_points: int = 16384, seed: int = 0) -> None:
        check_range("transforms.aggregate.alpha", alpha, 0.0, 1.0, open_low=True)
        if max_points < 1:
            raise ConfigError(f"transforms.aggregate.max_points={max_points}: give at least 1.")
        super().__init__(
            in_keys=list(_IN_KEYS),
            out_keys=list(_OUT_KEYS),
            seed=seed,
        )
        self.alpha = alpha
        self.max_points = max_points
        self._unions: list[_Union] = []

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        n = tensordict_reset.batch_size.numel()
        if len(self._unions) != n:
            self._unions = [_Union() for _ in range(n)]
        rows = _marked_rows(tensordict, "_reset", n)
        for row in rows:
            self._unions[row] = _Union()
        return self._add_views(tensordict_reset, self._unions, rows)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        rows = _marked_rows(tensordict, "_step", len(self._unions))
        return self._add_views(next_tensordict, self._unions, rows)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Aggregate a tensordict of trajectories [*, T], and its "next" where there is one."""
        if not tensordict.batch_dims:
            raise ConfigError("AggregatePoints needs a time dimension, the last of the batch: give [*, T].")
        after = tensordict.get("next", None)
        horizon, n = tensordict.batch_size[-1], tensordict.batch_size[:-1].numel()
        unions = [_Union() for _ in range(n)]
        fresh = torch.ones(n, dtype=torch.bool)
        steps, next_steps = [], []
        for t in range(horizon):
            now: Any = tensordict[..., t]
            now = now.exclude("next")
            rows = range(n)
            if after is not None:
                rows = fresh.nonzero()[:, 0].tolist()
                for row in rows:
                    unions[row] = _Union()
            steps.append(self._add_views(now, unions, list(rows)))
            if after is not None:
                done = after.get("done")[..., t, :].reshape(n, -1).any(-1).cpu()
                next_steps.append(self._add_views(after[..., t].copy(), unions, list(range(n))))
                fresh = done
        out: Any = torch.stack(steps, dim=-1)
        tensordict.update(out.select(*_OUT_KEYS))
        if after is not None:
            next_out: Any = torch.stack(next_steps, dim=-1)
            tensordict.set("next", after.update(next_out.select(*_OUT_KEYS)))
        return tensordict

    def _add_views(self, tensordict: TensorDictBase, unions: list[_Union], rows: list[int]) -> TensorDictBase:
        """Add the views of the batch elements `rows`, and write every union in today's hand frame."""
        points, counts, T_base_ee = (flat_batch(tensordict.get(key), tensordict) for key in _IN_KEYS)
        generators = self._generators(tensordict)
        for row in rows:
            seen = points[row, : int(counts[row])]
            self._add_view(unions[row], transform_points(T_base_ee[row], seen), generators[row])
        T_ee_base = invert_pose(T_base_ee)
        clouds = [transform_points(T_ee_base[i], union.points.to(points)) for i, union in enumerate(unions)]
        points, counts = pad_clouds(clouds, self.max_points)
        batch = tensordict.batch_size
        tensordict.set(keys.POINTS, points.reshape(*batch, -1, 3))
        tensordict.set(keys.NUM_POINTS, counts.reshape(*batch, 1).to(points.device))
        return tensordict

    def _add_view(self, union: _Union, seen: Tensor, rng: np.random.Generator) -> None:
        drawn = math.ceil(self.alpha**union.views * len(seen) - _ROUNDING)
        union.views += 1
        if drawn < len(seen):
            seen = seen[torch.from_numpy(rng.permutation(len(seen))[:drawn])]
        union.points = torch.cat((union.points.to(seen), seen))
        if len(union.points) > self.max_points:
            union.points = union.points[
                torch.from_numpy(rng.permutation(len(union.points))[: self.max_points])
            ]

    def _out_shapes(self, observation_spec: Composite) -> dict:
        return {keys.POINTS: ((self.max_points, 3), torch.float32), keys.NUM_POINTS: ((1,), torch.int64)}


def _marked_rows(tensordict: TensorDictBase | None, key: str, n: int) -> list[int]:
    """Which of n batch elements a mask in the tensordict marks; all where there is none."""
    mask = None if tensordict is None else tensordict.get(key, None)
    return list(range(n)) if mask is None else mask.reshape(n, -1).any(-1).nonzero()[:, 0].tolist()
