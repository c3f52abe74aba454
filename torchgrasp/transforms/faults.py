"""What goes wrong with points: JitterPoints, and DropPoints for what is hidden or lost."""

from __future__ import annotations

from typing import Literal

import numpy as np
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range
from torchgrasp.transforms.base import (
    PointTransform,
    check_is_cloud,
    pad_clouds,
    read_rows,
    write_clouds,
    write_rows,
)


class JitterPoints(PointTransform):
    """Moves each of the first NUM_POINTS rows of POINTS by Gaussian noise.

    It belongs before SamplePoints, which copies rows, and before AppendGripperPoints.

    Args:
        sigma: standard deviation along each axis, metres.
        bound: most that a point moves along an axis, metres.
        seed: of the draws.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> td = TensorDict({"points": torch.zeros(9, 3), "num_points": torch.tensor([5])})
        >>> JitterPoints(sigma=0.01)(td)["points"].any(-1).sum()
        tensor(5)
    """

    simulates_sensor = True

    def __init__(self, sigma: float = 0.001, *, bound: float = 0.005, seed: int = 0) -> None:
        check_range("sigma", sigma, 0.0, float("inf"))
        check_range("bound", bound, 0.0, float("inf"))
        super().__init__(in_keys=[keys.POINTS, keys.NUM_POINTS], out_keys=[keys.POINTS], seed=seed)
        self.sigma, self.bound = sigma, bound

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        points, counts = read_rows(next_tensordict, *self.in_keys)
        check_is_cloud("JitterPoints", points)
        out = points.copy()
        for row, rng in enumerate(self._generators(next_tensordict)):
            n = int(counts[row, 0])
            noise = np.float32(self.sigma) * rng.standard_normal((n, 3), dtype=np.float32)
            out[row, :n] += noise.clip(-self.bound, self.bound)
        write_rows(next_tensordict, keys.POINTS, out)
        return next_tensordict


class DropPoints(PointTransform):
    """Leaves out points of the first NUM_POINTS rows of POINTS: some at random, and one connected part.

    The part stands for something in the way. Its share of the cloud is drawn uniformly up to
    `occluded`; as a "ball" it holds the points nearest to one of them, as a "half_space" those
    farthest along a direction. The others keep their order; NUM_POINTS says how many they are.

    It belongs before AppendGripperPoints; before AggregatePoints every view loses other points.

    Args:
        dropped: share of the cloud left out at random.
        occluded: largest share that the part takes.
        part: its shape.
        probability: that a cloud loses a part at all.
        seed: of the draws.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> td = TensorDict({"points": torch.rand(100, 3), "num_points": torch.tensor([80])})
        >>> DropPoints(dropped=0.25, occluded=0.0)(td)["num_points"]
        tensor([60])
    """

    simulates_sensor = True

    def __init__(
        self,
        *,
        dropped: float = 0.1,
        occluded: float = 0.3,
        part: Literal["ball", "half_space"] = "ball",
        probability: float = 0.5,
        seed: int = 0,
    ) -> None:
        for name, value in (("dropped", dropped), ("occluded", occluded), ("probability", probability)):
            check_range(name, value, 0.0, 1.0)
        if part not in ("ball", "half_space"):
            raise ConfigError(f"part={part!r} is unknown: give ball or half_space.")
        both = [keys.POINTS, keys.NUM_POINTS]
        super().__init__(in_keys=both, out_keys=list(both), seed=seed)
        self.dropped, self.occluded, self.part, self.probability = dropped, occluded, part, probability

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        points, counts = read_rows(next_tensordict, *self.in_keys)
        check_is_cloud("DropPoints", points)
        clouds = []
        for row, rng in enumerate(self._generators(next_tensordict)):
            cloud = points[row, : counts[row, 0]]
            clouds.append(cloud[self._stays(cloud, rng)] if len(cloud) else cloud)
        write_clouds(next_tensordict, pad_clouds(clouds, points.shape[1]), [len(each) for each in clouds])
        return next_tensordict

    def _stays(self, cloud: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """(n,) bool: which points of a cloud (n, 3) are kept."""
        stays = np.ones(len(cloud), dtype=bool)
        if rng.random() < self.probability:
            hidden = int(rng.uniform(0.0, self.occluded) * len(cloud))
            stays[np.argsort(self._distance(cloud, rng), kind="stable")[:hidden]] = False
        stays[rng.permutation(len(cloud))[: round(self.dropped * len(cloud))]] = False
        return stays

    def _distance(self, cloud: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """(n,) from the middle of the ball, or against the direction of the half-space."""
        if self.part == "ball":
            return np.linalg.norm(cloud - cloud[rng.integers(len(cloud))], axis=-1)
        return cloud @ rng.standard_normal(3).astype(np.float32)
