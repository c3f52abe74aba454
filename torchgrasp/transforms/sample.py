"""SamplePoints: a fixed number of points for the network."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Composite

from torchgrasp import keys
from torchgrasp.errors import check_whole
from torchgrasp.transforms.base import PointTransform, check_is_cloud, read_rows, write_clouds


class SamplePoints(PointTransform):
    """Draws POINTS (*, num_points, 3) uniformly from the first NUM_POINTS rows (Sec. 6.2: 1024).

    Without replacement where there are enough; where there are fewer, every point is taken and the
    rest are drawn again. A cloud without points becomes zeros, and NUM_POINTS tells so with 0.

    Args:
        num_points: of the result.
        seed: of the draws.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> td = TensorDict({"points": torch.rand(2, 50, 3), "num_points": torch.tensor([[50], [7]])}, [2])
        >>> SamplePoints(16)(td)["points"].shape
        torch.Size([2, 16, 3])
    """

    def __init__(self, num_points: int = 1024, *, seed: int = 0) -> None:
        check_whole("num_points", num_points, 1, 1_000_000)
        super().__init__(
            in_keys=[keys.POINTS, keys.NUM_POINTS], out_keys=[keys.POINTS, keys.NUM_POINTS], seed=seed
        )
        self.num_points = num_points

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        points, counts = read_rows(next_tensordict, *self.in_keys)
        check_is_cloud("SamplePoints", points)
        out = np.zeros((len(points), self.num_points, 3), dtype=np.float32)
        for row, rng in enumerate(self._generators(next_tensordict)):
            if n := int(counts[row, 0]):
                index = rng.permutation(n)[: self.num_points]
                if n < self.num_points:
                    index = np.concatenate((index, rng.integers(n, size=self.num_points - n)))
                out[row] = points[row].take(index, axis=0)
        write_clouds(next_tensordict, out, np.minimum(counts[:, 0], self.num_points).tolist())
        return next_tensordict

    def _out_shapes(self, observation_spec: Composite) -> dict:
        return {keys.POINTS: ((self.num_points, 3), torch.float32), keys.NUM_POINTS: ((1,), torch.int64)}
