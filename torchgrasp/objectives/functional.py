"""The paper's losses as functions of tensors. Leading `*` is any batch; nothing here knows tensordicts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import (
    ACTION_SIZE,
    GOAL_SIZE,
    euler_to_rotation,
    gripper_control_points,
    quaternion_to_rotation,
)

PointNorm = Literal["l1", "l2"]


def pose_distance(T1: Tensor, T2: Tensor, points: Tensor | None = None, *, norm: PointNorm = "l1") -> Tensor:
    """L_POSE of Eq. (2): (*, 4, 4) poses to (*) metres, the mean over X_g of ||T1 x - T2 x||.

    The paper's norm is L1 over x, y and z; 'l2' is the points' Euclidean distance. `points` (M, 3)
    replaces the gripper's six control points X_g, metres, in the frame that the poses map from.

    Example:
        >>> shifted = torch.eye(4)
        >>> shifted[:3, 3] = torch.tensor([0.01, -0.02, 0.0])
        >>> round(pose_distance(torch.eye(4), shifted).item(), 4)
        0.03
    """
    check_norm(norm)
    T1, T2 = _one_dtype(T1, T2)
    difference = T1 - T2
    return _mean_length(difference[..., :3, :3], difference[..., :3, 3], points, norm)


def _mean_length(rotation: Tensor, translation: Tensor, points: Tensor | None, norm: PointNorm) -> Tensor:
    """Mean over X_g of ||(R1 - R2) x + t1 - t2||, of the differences (*, 3, 3) and (*, 3): (*) metres."""
    if points is None:
        points = gripper_control_points(dtype=rotation.dtype, device=rotation.device)
    difference = rotation @ points.mT + translation.unsqueeze(-1)  # (*, 3, M)
    if norm == "l1":
        return difference.abs().sum(dim=-2).mean(dim=-1)
    return torch.linalg.vector_norm(difference, dim=-2).mean(dim=-1)


def check_norm(norm: str) -> None:
    """Raise ConfigError unless `norm` is one that `pose_distance` knows."""
    if norm not in ("l1", "l2"):
        raise ConfigError(f"norm={norm!r} is unknown: choose 'l1', the paper's, or 'l2'.")


def action_distance(action: Tensor, other: Tensor, *, norm: PointNorm = "l1") -> Tensor:
    """L_POSE between (*, 6) actions, metres and Euler angles (Sec. 6.4): (*) metres."""
    _check_size("action_distance", ACTION_SIZE, action, other, remedy="distance=")
    return _vector_distance(action, other, euler_to_rotation, norm)


def goal_distance(goal: Tensor, other: Tensor, *, norm: PointNorm = "l1") -> Tensor:
    """L_POSE between (*, 7) goals, metres and quaternion xyzw of either sign: (*) metres."""
    _check_size("goal_distance", GOAL_SIZE, goal, other, remedy="goal_distance= (distance= of GoalAuxLoss)")
    return _vector_distance(goal, other, quaternion_to_rotation, norm)


def _vector_distance(
    first: Tensor, second: Tensor, to_rotation: Callable[[Tensor], Tensor], norm: PointNorm
) -> Tensor:
    """L_POSE between (*, 3 + R) vectors, metres and what `to_rotation` takes: (*) metres."""
    check_norm(norm)
    first, second = torch.broadcast_tensors(*_one_dtype(first, second))
    rotations = to_rotation(torch.stack((first, second))[..., 3:])  # of both at once: half the operations
    return _mean_length(rotations[0] - rotations[1], first[..., :3] - second[..., :3], None, norm)


def masked_mean(values: Tensor, mask: Tensor | None = None, weights: Tensor | None = None) -> Tensor:
    """The mean of the (*) values where the (*) bool mask is true; 0, with its graph, where it never is.

    Values outside the mask may be anything, NaN included. With `weights` (*) it is the weighted mean.

    Example:
        >>> masked_mean(torch.tensor([1.0, 3.0, torch.nan]), torch.tensor([True, True, False]))
        tensor(2.)
    """
    counted = torch.ones_like(values) if mask is None else mask.to(values.dtype)
    values = values if mask is None else torch.where(mask, values, 0.0)
    if weights is not None:
        counted, values = counted * weights, values * weights
    count = counted.sum()
    return values.sum() / torch.where(count > 0, count, 1.0)


def _one_dtype(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Both in the wider of their types: a label keeps its digits beside a bfloat16 prediction."""
    dtype = torch.promote_types(first.dtype, second.dtype)
    return first.to(dtype), second.to(dtype)


def _check_size(name: str, size: int, *vectors: Tensor, remedy: str) -> None:
    for vector in vectors:
        if vector.ndim == 0 or vector.shape[-1] != size:
            raise ConfigError(
                f"{name} compares (*, {size}) tensors and was given {tuple(vector.shape)}: give those, or "
                f"replace it by a distance of your own, {remedy} of the loss."
            )
