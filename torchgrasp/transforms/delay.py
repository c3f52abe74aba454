"""DelayObservation: a picture, or what was made of it, that comes some steps late (Sec. 6.8)."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from tensordict import NestedKey, TensorDictBase

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.transforms.base import read_rows, write_rows
from torchgrasp.transforms.history import HistoryTransform

Memory = deque[list[np.ndarray]]


class DelayObservation(HistoryTransform[Memory]):
    """Shows some entries as they were `steps` steps ago; at first, as they were when the episode began.

    With MASK alone, the default, segmentation lags behind the depth, as a module of its own does (Sec.
    6.8): where the hand moved meanwhile, the mask marks other pixels than the target's. With the
    whole picture and T_BASE_CAMERA, the camera's pose as of then, the view is old but right.

    In an environment each world has a delay line of its own, filled anew at its reset. On a tensordict
    that is not an environment's, the last batch dimension is time.

    Args:
        steps: of the delay; 0 changes nothing.
        names: entries that come late.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> td = TensorDict({"seen": torch.arange(5.0)[:, None]}, [5])
        >>> DelayObservation(2, names=["seen"])(td)["seen"].flatten().tolist()
        [0.0, 0.0, 0.0, 1.0, 2.0]
    """

    simulates_sensor = True

    def __init__(self, steps: int = 1, *, names: Sequence[NestedKey] = (keys.MASK,)) -> None:
        if isinstance(steps, bool) or not isinstance(steps, int) or steps < 0:
            raise ConfigError(f"steps={steps!r}: give a whole number of at least 0.")
        if isinstance(names, str) or not len(names):
            raise ConfigError(f"names={names!r}: give a list of at least one key.")
        late = [name if isinstance(name, str) else tuple(name) for name in names]
        super().__init__(in_keys=late, out_keys=list(late))
        self.steps = steps

    def _begin(self) -> Memory:
        return deque(maxlen=self.steps + 1)

    def _see(self, tensordict: TensorDictBase, memories: list[Memory], rows: list[int]) -> TensorDictBase:
        now = read_rows(tensordict, *self.in_keys)
        for row in rows:
            memories[row].append([entry[row].copy() for entry in now])
        for column, name in enumerate(self.out_keys):
            write_rows(tensordict, name, np.stack([memory[0][column] for memory in memories]))
        return tensordict
