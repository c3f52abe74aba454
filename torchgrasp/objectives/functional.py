"""The paper's losses as functions of tensors. Leading `*` is any batch; nothing here knows tensordicts."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import action_to_pose, goal_to_pose, gripper_control_points, transform_points

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
    if norm not in ("l1", "l2"):
        raise ConfigError(f"norm={norm!r} is unknown: choose 'l1', the paper's, or 'l2'.")
    if points is None:
        points = gripper_control_points(dtype=T1.dtype, device=T1.device)
    difference = transform_points(T1, points) - transform_points(T2, points)  # (*, M, 3)
    if norm == "l1":
        return difference.abs().sum(dim=-1).mean(dim=-1)
    return torch.linalg.vector_norm(difference, dim=-1).mean(dim=-1)


def action_distance(action: Tensor, other: Tensor, *, norm: PointNorm = "l1") -> Tensor:
    """L_POSE between (*, 6) actions, metres and Euler angles (Sec. 6.4): (*) metres."""
    return pose_distance(action_to_pose(action), action_to_pose(other), norm=norm)


def goal_distance(goal: Tensor, other: Tensor, *, norm: PointNorm = "l1") -> Tensor:
    """L_POSE between (*, 7) goals, metres and quaternion xyzw of either sign: (*) metres."""
    return pose_distance(goal_to_pose(goal), goal_to_pose(other), norm=norm)


def masked_mean(values: Tensor, mask: Tensor | None = None) -> Tensor:
    """The mean of the (*) values where the (*) mask is true; 0, with its graph, where it never is.

    Values outside the mask may be anything, NaN included.

    Example:
        >>> masked_mean(torch.tensor([1.0, 3.0, torch.nan]), torch.tensor([True, True, False]))
        tensor(2.)
    """
    if mask is None:
        return values.mean()
    return torch.where(mask, values, 0.0).sum() / mask.sum().clamp_min(1)


def bellman_target(reward: Tensor, terminated: Tensor, next_values: Tensor, gamma: float | Tensor) -> Tensor:
    """Target y of Eq. (3): reward + gamma * the least of the next values, unless terminated.

    `reward` and `terminated` are (*, 1), `next_values` (*, Q); the result is (*, 1).

    Example:
        >>> bellman_target(torch.tensor([1.0]), torch.tensor([False]), torch.tensor([0.8, 0.4]), 0.5)
        tensor([1.2000])
    """
    least = next_values.amin(dim=-1, keepdim=True)
    return reward + gamma * torch.where(terminated, 0.0, least)
