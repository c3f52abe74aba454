"""DepthNoise: what a depth sensor does to a picture. Noise, steps of disparity, holes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from tensordict import TensorDictBase

from torchgrasp.errors import ConfigError, check_range
from torchgrasp.transforms.base import CameraName, PointTransform, camera_keys, read_rows, write_rows

_INFINITY = float("inf")


class DepthNoise(PointTransform):
    """Makes DEPTH (*, H, W) that of a real sensor, and MASK with it: a pixel without a return is no target.

    In this order: pixels show what lies a little beside them (lateral noise); depth gets Gaussian noise
    that grows with distance, sigma(z) = a + b (z - c)^2 (axial noise); it is rounded to what the sensor's
    disparities can tell apart; pixels beside a jump of depth, and others at random, lose their return.

    Nguyen, Izadi and Lovell (2012, *Modeling Kinect Sensor Noise*) measured a = 1.2 mm, b = 1.9 mm/m^2,
    c = 0.4 m, and 0.8 px sideways with 580 px of focal length. For a stereo camera a = c = 0 and
    b = (error of a disparity in px) / (focal length in px * baseline in m): 0.0038 for 0.08 px, 420 px
    and 5 cm, the size of a RealSense D435.

    Args:
        axial: (a, b, c) of the axial noise, in m, 1/m and m; zeros for none.
        lateral: standard deviation sideways, pixels of this picture. A pixel of 112 in 90 degrees is ten
            times as wide as a Kinect's.
        disparity_step: of 1/z, in 1/m: (step of the disparity in px) / (focal length * baseline); a Kinect
            has 1/8 px, 580 px and 7.5 cm, thus 0.0029. 0 for none.
        edge_step: metres between neighbours that make an edge.
        edge_holes: probability that a pixel at an edge has no return.
        dropout: probability that any other has none.
        camera: whose picture, wrist or overhead.
        seed: of the draws.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> wall = TensorDict({"camera": {"depth": torch.ones(64, 64), "mask": torch.ones(64, 64).bool()}})
        >>> noisy = DepthNoise(dropout=0.5)(wall)["camera"]
        >>> bool(((noisy["depth"] > 0) == noisy["mask"]).all())
        True
    """

    simulates_sensor = True

    def __init__(
        self,
        *,
        axial: Sequence[float] = (0.0012, 0.0019, 0.4),
        lateral: float = 0.25,
        disparity_step: float = 0.0029,
        edge_step: float = 0.02,
        edge_holes: float = 0.3,
        dropout: float = 0.005,
        camera: CameraName = "wrist",
        seed: int = 0,
    ) -> None:
        if len(axial) != 3:
            raise ConfigError(f"axial={list(axial)} has {len(axial)} numbers: give a, b, c.")
        limits = {"lateral": lateral, "disparity_step": disparity_step, "edge_step": edge_step}
        limits |= {f"axial[{i}]": each for i, each in enumerate(axial)}
        for name, value in limits.items():
            check_range(name, value, 0.0, _INFINITY)
        for name, value in (("edge_holes", edge_holes), ("dropout", dropout)):
            check_range(name, value, 0.0, 1.0)
        source = camera_keys(camera)
        both = [source.depth, source.mask]
        super().__init__(in_keys=both, out_keys=list(both), seed=seed)
        self.axial = tuple(float(each) for each in axial)
        self.lateral = lateral
        self.disparity_step = disparity_step
        self.edge_step = edge_step
        self.edge_holes = edge_holes
        self.dropout = dropout

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        depth, mask = read_rows(next_tensordict, *self.in_keys)
        depth, mask = depth.copy(), mask.copy()
        for row, rng in enumerate(self._generators(next_tensordict)):
            depth[row], mask[row] = self._worsen(depth[row], mask[row], rng)
        for key, rows in zip(self.out_keys, (depth, mask), strict=True):
            write_rows(next_tensordict, key, rows)
        return next_tensordict

    def _worsen(
        self, depth: np.ndarray, mask: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """One (H, W) picture of depth and mask as the sensor gives it."""
        if self.lateral:
            beside = _beside(depth.shape, self.lateral, rng)
            depth, mask = depth[beside], mask[beside]
        lost = self._lost(depth, rng)
        a, b, c = self.axial
        if a or b:
            noise = rng.standard_normal(depth.shape, dtype=np.float32)
            depth = depth + (a + b * (depth - np.float32(c)) ** 2) * noise
        if self.disparity_step:
            depth = _quantise(depth, self.disparity_step)
        depth = np.where(lost, np.float32(0.0), np.maximum(depth, 0.0))
        return depth, mask & (depth > 0)

    def _lost(self, depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """(H, W) where there is no return: there was none, at edges, at random."""
        probability = np.where(_edges(depth, self.edge_step), self.edge_holes, self.dropout)
        return (depth <= 0) | (rng.random(depth.shape, dtype=np.float32) < probability)


def _beside(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Index of the pixel that each of (H, W) shows: itself, or one some rounded draws away."""
    rows, columns = np.indices(shape)
    moved = np.rint(sigma * rng.standard_normal((2, *shape), dtype=np.float32)).astype(np.int64)
    return (rows + moved[0]).clip(0, shape[0] - 1), (columns + moved[1]).clip(0, shape[1] - 1)


def _quantise(depth: np.ndarray, step: float) -> np.ndarray:
    """Depths whose inverse is a multiple of `step`; what is too far for one step is as far as one tells."""
    seen = depth > 0
    inverse = np.maximum(np.rint(1.0 / np.where(seen, depth, 1.0) / step), 1.0)
    return np.where(seen, 1.0 / (inverse * step), 0.0).astype(np.float32)


def _edges(depth: np.ndarray, step: float) -> np.ndarray:
    """(H, W) pixels that differ from one of their four neighbours by more than `step` metres."""
    edges = np.zeros(depth.shape, dtype=bool)
    down = np.abs(np.diff(depth, axis=0)) > step
    right = np.abs(np.diff(depth, axis=1)) > step
    edges[1:] |= down
    edges[:-1] |= down
    edges[:, 1:] |= right
    edges[:, :-1] |= right
    return edges
