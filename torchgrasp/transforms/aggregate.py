"""AggregatePoints: the state s_t, all views of the episode in today's hand frame (Sec. 6.2)."""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.ndimage import minimum_filter
from tensordict import TensorDictBase
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.transforms.base import (
    CameraName,
    camera_keys,
    check_is_cloud,
    check_lens,
    choose_intrinsics,
    read_rows,
    write_clouds,
)
from torchgrasp.transforms.history import HistoryTransform

# Powers of alpha carry errors that must not add a point: 0.9**2 * 100 is 81.00000000000001 in floats.
_ROUNDING = 1e-9
# A target out of sight goes on by the largest of its last shifts, as part of it may have left the picture in
# the others, and with every step by this share of the step before.
_SHIFTS, _SLOWING = 3, 0.85


class _Track:
    """Where the target is, (1, 3) in the base frame: the mean of what is seen of it, then a guess."""

    def __init__(self) -> None:
        self._place: np.ndarray | None = None
        self._pace = np.zeros((1, 3), dtype=np.float32)
        self._shifts: list[np.ndarray] = []
        self._seen_at = -1

    def see(self, points: np.ndarray, view: int) -> None:
        """Take it to be where the (n, 3) points of this view are."""
        place = points.mean(axis=0, keepdims=True)
        if self._place is None or self._seen_at != view - 1:
            self._shifts = []
        else:
            self._shifts = [*self._shifts, place - self._place][-_SHIFTS:]
        self._place, self._seen_at = place, view
        self._pace = max(self._shifts, key=np.linalg.norm, default=np.zeros_like(place))

    def go_on(self, view: int) -> np.ndarray | None:
        """Take it to go on as it went when it was seen, ever more slowly; None where this view shows it.

        None as well where no view has shown it yet.
        """
        if self._place is None or self._seen_at == view:
            return None
        self._pace = _SLOWING * self._pace
        self._place = self._place + self._pace
        return self._place


class _Union:
    """The views of one episode so far: points in the base frame and t, the number of views.

    Points are homogeneous, (M, 4) with a last column of ones, so that one product moves them; the rows
    behind them are room for more. Once all of them have gone, the only one is where the target may be.
    """

    def __init__(self) -> None:
        self.views = 0
        self.size = 0
        self._rows = np.ones((1024, 4), dtype=np.float32)
        self._track = _Track()
        self._has_gone = False

    @property
    def points(self) -> np.ndarray:
        return self._rows[: self.size]

    def append(self, points: np.ndarray) -> None:
        """Add (n, 3) points."""
        size = self.size + len(points)
        if size > len(self._rows):
            rows = np.ones((2 * size, 4), dtype=np.float32)
            rows[: self.size] = self.points
            self._rows = rows
        self._rows[self.size : size, :3] = points
        self.size = size

    def keep(self, index: np.ndarray) -> None:
        """Keep the points of these rows alone."""
        self._rows[: len(index)] = self._rows[index]
        self.size = len(index)

    def find(self, seen: np.ndarray) -> None:
        """Know where the target is by the (n, 3) points of this view, and forget where it might have been."""
        self._track.see(seen, self.views)
        if self._has_gone:
            self.size, self._has_gone = 0, False

    def stand_in(self) -> None:
        """Have where the target may be stand for it, if no point of it is left and this view shows none."""
        if self.size == 0 or self._has_gone:
            place = self._track.go_on(self.views)
            if place is not None:
                self.size, self._has_gone = 0, True
                self.append(place)


class AggregatePoints(HistoryTransform[_Union]):
    """Joins the views of an episode: s_t = T_t(union of T_i^-1(X_i) for i <= t) (Sec. 6.2).

    Of the n_t points seen at t, m_t = ceil(alpha^t n_t) are drawn uniformly and kept in the base frame;
    POINTS then holds the union in the hand frame at t, and NUM_POINTS its size. In an environment each
    world's union begins anew at its reset. On a tensordict that is not an environment's, the last batch
    dimension is time, and a union begins anew after each ("next", "done").

    With `carve` a point goes when the camera looks through the place where it was: the target has moved
    (Sec. 6.6, where the paper gives up aggregation). Neighbouring pixels must agree, so that outlines stay; a
    pixel without a return is empty space, which a sensor with holes cannot claim. Once all points have gone
    and none is in view, one stands for the target until it is seen again: it goes on from the mean of those
    seen last as that went, ever more slowly. Without it nothing would tell which way the target went.

    Args:
        alpha: share that the draw shrinks by at every step; 1 keeps every point.
        max_points: of the union; beyond it a uniform draw of the union is kept.
        carve: metres that a point must lie in front of what is seen behind it to go; None keeps all.
        fov: the camera's vertical field of view, radians, for `carve`; 90 degrees by default.
        intrinsics: of the camera instead, as for `DepthToPoints`.
        camera: whose picture, for `carve`: the wrist's or the static one's.
        seed: of the draws.
    """

    def __init__(
        self,
        alpha: float = 0.95,
        *,
        max_points: int = 16384,
        carve: float | None = None,
        fov: float | None = None,
        intrinsics: CameraIntrinsics | None = None,
        camera: CameraName = "wrist",
        seed: int = 0,
    ) -> None:
        check_range("alpha", alpha, 0.0, 1.0, open_low=True)
        check_lens(intrinsics, fov)
        if carve is not None:
            check_range("carve", carve, 0.0, math.inf)
        if max_points < 1:
            raise ConfigError(f"max_points={max_points}: give at least 1.")
        source = camera_keys(camera)
        seen = [] if carve is None else [source.depth, source.pose]
        super().__init__(
            in_keys=[keys.POINTS, keys.NUM_POINTS, keys.T_BASE_EE, *seen],
            out_keys=[keys.POINTS, keys.NUM_POINTS],
            seed=seed,
        )
        self.alpha = alpha
        self.max_points = max_points
        self.carve = carve
        self.fov, self.intrinsics = fov, intrinsics

    def _begin(self) -> _Union:
        return _Union()

    def _see(self, tensordict: TensorDictBase, memories: list[_Union], rows: list[int]) -> TensorDictBase:
        points, counts, T_base_ee, *picture = read_rows(tensordict, *self.in_keys)
        check_is_cloud("AggregatePoints", points)
        generators = self._generators(tensordict, rows)
        if self.carve is not None:
            depth, T_base_camera = picture
            for row in rows:
                seen_through = self._find_seen_through(memories[row].points, depth[row], T_base_camera[row])
                memories[row].keep(np.flatnonzero(~seen_through))
        for row, rng in zip(rows, generators, strict=True):
            self._add_view(memories[row], points[row, : counts[row, 0]], T_base_ee[row], rng)
            if self.carve is not None:
                memories[row].stand_in()
        out = np.zeros((len(memories), self.max_points, 3), dtype=np.float32)
        for cloud, union, pose in zip(out, memories, T_base_ee, strict=True):
            # R^T (x - p) for rows x: [x 1] times R above -p^T R.
            inverse = np.concatenate((pose[:3, :3], -pose[:3, 3:].T @ pose[:3, :3]))
            np.matmul(union.points, inverse, out=cloud[: union.size])
        write_clouds(tensordict, out, [union.size for union in memories])
        return tensordict

    def _find_seen_through(
        self, points: np.ndarray, depth: np.ndarray, T_base_camera: np.ndarray
    ) -> np.ndarray:
        """(M,) which homogeneous points (M, 4) of the base lie in front of all that their pixels show."""
        height, width = depth.shape
        lens = choose_intrinsics(self.intrinsics, self.fov, height, width)
        x, y, z = ((points[:, :3] - T_base_camera[:3, 3]) @ T_base_camera[:3, :3]).T
        ahead = np.maximum(z, 1e-6)
        (fx, fy), (cx, cy) = lens.focal.tolist(), lens.centre.tolist()
        u = np.floor(fx * x / ahead + cx)
        v = np.floor(fy * y / ahead + cy)
        inside = (z > 1e-6) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        nearest = minimum_filter(np.where(depth > 0, depth, np.inf), size=3)
        behind = nearest[np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)]
        return inside & (z + self.carve < behind)

    def _add_view(
        self, union: _Union, seen: np.ndarray, T_base_ee: np.ndarray, rng: np.random.Generator
    ) -> None:
        drawn = math.ceil(self.alpha**union.views * len(seen) - _ROUNDING)
        union.views += 1
        seen = seen @ T_base_ee[:3, :3].T + T_base_ee[:3, 3]
        if len(seen):
            union.find(seen)
        if drawn < len(seen):
            seen = seen.take(rng.permutation(len(seen))[:drawn], axis=0)
        union.append(seen)
        if union.size > self.max_points:
            union.keep(rng.permutation(union.size)[: self.max_points])

    def _out_shapes(self, observation_spec: Composite) -> dict:
        return {keys.POINTS: ((self.max_points, 3), torch.float32), keys.NUM_POINTS: ((1,), torch.int64)}
