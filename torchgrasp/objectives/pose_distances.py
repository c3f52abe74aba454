"""L_POSE with its norm, as a part that a configuration can name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from torch import Tensor

from torchgrasp.objectives import functional
from torchgrasp.objectives.functional import PointNorm


@dataclass(frozen=True)
class PoseDistance(ABC):
    """A distance between two batches of poses; a loss takes any callable of this form.

    Attributes:
        norm: over x, y and z: 'l1' (Eq. 2) or 'l2'.
    """

    norm: PointNorm = "l1"

    def __post_init__(self) -> None:
        functional.check_norm(self.norm)

    @abstractmethod
    def __call__(self, pose: Tensor, other: Tensor) -> Tensor:
        """(*, A) poses in the coordinates of the subclass to (*) metres."""


class ActionDistance(PoseDistance):
    """L_POSE between (*, 6) actions.

    Example:
        >>> import torch
        >>> round(ActionDistance("l2")(torch.zeros(6), torch.tensor([0.03, 0.04, 0, 0, 0, 0])).item(), 4)
        0.05
    """

    def __call__(self, pose: Tensor, other: Tensor) -> Tensor:
        """(*, 6) metres and Euler angles to (*) metres."""
        return functional.action_distance(pose, other, norm=self.norm)


class GoalDistance(PoseDistance):
    """L_POSE between (*, 7) goals."""

    def __call__(self, pose: Tensor, other: Tensor) -> Tensor:
        """(*, 7) metres and quaternions xyzw of either sign to (*) metres."""
        return functional.goal_distance(pose, other, norm=self.norm)
