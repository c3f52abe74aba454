"""What one arm's episode has shown so far."""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from torchgrasp import keys
from torchgrasp.config.trained_view import TrainedView
from torchgrasp.deploy.sight import Sight


class ArmEpisode:
    """One arm's episode: its view, the steps taken, and where and when the target was last seen.

    Args:
        number: of the arm.
        view: the policy's transforms, of this arm alone.
        horizon: T, steps of an episode.

    Attributes:
        steps: taken so far.
        num_points: of the target that the policy was shown last.
        age: seconds since the target was last seen.
        T_base_seen: (4, 4) hand pose then; None where it has not been seen.
    """

    def __init__(self, number: int, view: TrainedView, horizon: int) -> None:
        self.number, self._view, self._horizon = number, view, horizon
        self._episode = self.steps = 0
        self.reset()

    @property
    def over(self) -> bool:
        """Whether all T steps are taken."""
        return self.steps >= self._horizon

    def reset(self) -> None:
        """Forget the episode; one that has not begun stays as it is."""
        self._episode += self.steps > 0
        self.steps = self.num_points = 0
        self.age = float("inf")
        self.T_base_seen: np.ndarray | None = None

    def see(
        self,
        sight: Sight,
        T_base_ee: np.ndarray,
        T_base_camera: np.ndarray | None,
        joints: np.ndarray | None,
    ) -> TensorDictBase:
        """The state [1] that the policy reads."""
        left = torch.tensor([[1.0 - self.steps / self._horizon]], dtype=torch.float32)
        where = {keys.WORLD: torch.tensor([[self.number]]), keys.EPISODE: torch.tensor([[self._episode]])}
        state = TensorDict({**where, keys.TIME_LEFT: left}, [1])
        state[keys.T_BASE_EE] = _row(T_base_ee)
        if joints is not None:
            state[keys.JOINTS] = _row(joints)
        if T_base_camera is not None:
            state[keys.T_BASE_CAMERA] = _row(T_base_camera)
        if sight.points is not None:
            state[keys.POINTS] = _row(sight.points)
            state[keys.NUM_POINTS] = torch.tensor([[len(sight.points)]])
        else:
            state[keys.DEPTH] = _row(cast(np.ndarray, sight.depth))
            state[keys.MASK] = torch.from_numpy(np.ascontiguousarray(sight.mask))[None]
        state = self._view.look(state, begins=self.steps == 0)
        self.num_points = int(state.get(keys.NUM_POINTS, torch.zeros(1)).sum())
        return state

    def note(self, sight: Sight, T_base_ee: np.ndarray, age: float, *, acted: bool, period: float) -> None:
        """Count a step that was taken, and remember where the target was seen."""
        self.steps += acted
        if acted and sight.shows_target:
            self.age, self.T_base_seen = age, T_base_ee
        else:
            self.age += period


def _row(array: np.ndarray) -> Tensor:
    """(1, ...) float32."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))[None]
