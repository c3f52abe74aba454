"""What an action means: the posture that the arm's drives are led to in one control step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

import numpy as np
import torch

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND, action_to_pose, invert_pose, pose_to_action
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.sim import kinematics
from torchgrasp.sim.kinematics import Array
from torchgrasp.sim.tracking import track_pose

ActionSpaceName = Literal["ee_delta", "joint_delta", "joint_velocity"]
# Metres above the table at which the controller holds the hand's lowest corner.
TABLE_GUARD = 0.002
# The next step corrects what this one leaves.
_TOLERANCE = 1e-4


class ActionSpace(ABC):
    """Turns actions into postures, and hand poses to be reached into actions.

    A posture that would put the hand into the table is raised: the controller knows its table, as a
    real one's workspace limits do, and a policy sees nothing of it.

    Args:
        control_period: seconds a step lasts.

    Attributes:
        bound: largest magnitude of each component.
        control_period: seconds a step lasts.
    """

    bound: tuple[float, ...]

    def __init__(self, control_period: float = 0.15) -> None:
        self.control_period = control_period

    @property
    def size(self) -> int:
        """Components of an action."""
        return len(self.bound)

    @abstractmethod
    def posture(self, q: Array, T_base_ee: Array, action: Array) -> Array:
        """(N, 7) angles that actions (N, size) within their bounds lead to from q (N, 7), hand (N, 4, 4)."""

    @abstractmethod
    def action_towards(self, q: Array, T_base_ee: Array, T_base_target: Array) -> Array:
        """(N, size) actions that take the hand to (N, 4, 4) poses a step away, as far as it reaches."""


class EeDelta(ActionSpace):
    """The hand's pose relative to where it is: metres, intrinsic XYZ Euler angles."""

    bound = ACTION_BOUND

    def posture(self, q: Array, T_base_ee: Array, action: Array) -> Array:
        """See `ActionSpace.posture`: inverse kinematics, as far as the joint limits let the arm go."""
        target = T_base_ee @ action_to_pose(torch.from_numpy(action)).numpy()
        target[:, 2, 3] += np.maximum(0.0, TABLE_GUARD - lowest_point(target))
        return track_pose(q, target, tolerance=_TOLERANCE)[0]

    def action_towards(self, q: Array, T_base_ee: Array, T_base_target: Array) -> Array:
        """See `ActionSpace.action_towards`: exact, whether the arm reaches the pose or not."""
        relative = invert_pose(torch.from_numpy(T_base_ee)) @ torch.from_numpy(T_base_target)
        return pose_to_action(relative).numpy()


class JointDelta(ActionSpace):
    """Changes of the seven arm angles in one step, radians (an ablation of Sec. 6.2).

    Args:
        control_period: seconds a step lasts; the bound is what a joint turns in it at its full speed.
    """

    def __init__(self, control_period: float = 0.15) -> None:
        super().__init__(control_period)
        self.bound = tuple((kinematics.JOINT_VELOCITY * control_period).tolist())

    def posture(self, q: Array, T_base_ee: Array, action: Array) -> Array:
        """See `ActionSpace.posture`."""
        q = np.clip(q + action, kinematics.JOINT_LOWER, kinematics.JOINT_UPPER)
        target = kinematics.forward_kinematics(q)
        low = TABLE_GUARD - lowest_point(target)
        rows = np.flatnonzero(low > 0.0)
        if len(rows):
            target[rows, 2, 3] += low[rows]
            q[rows] = track_pose(q[rows], target[rows], tolerance=_TOLERANCE)[0]
        return q

    def action_towards(self, q: Array, T_base_ee: Array, T_base_target: Array) -> Array:
        """See `ActionSpace.action_towards`: the way that inverse kinematics continues."""
        return track_pose(q, T_base_target, tolerance=_TOLERANCE)[0] - q


class JointVelocity(JointDelta):
    """Rates of the seven arm angles over one step, rad/s (an ablation of Sec. 6.2).

    Args:
        control_period: seconds a step lasts.
    """

    def __init__(self, control_period: float = 0.15) -> None:
        super().__init__(control_period)
        self.bound = tuple(kinematics.JOINT_VELOCITY.tolist())

    def posture(self, q: Array, T_base_ee: Array, action: Array) -> Array:
        """See `ActionSpace.posture`."""
        return super().posture(q, T_base_ee, action * self.control_period)

    def action_towards(self, q: Array, T_base_ee: Array, T_base_target: Array) -> Array:
        """See `ActionSpace.action_towards`."""
        return super().action_towards(q, T_base_ee, T_base_target) / self.control_period


def make_action_space(action_space: ActionSpaceName, *, control_period: float = 0.15) -> ActionSpace:
    """The action space of that name; `control_period` is the physics', seconds."""
    if action_space == "ee_delta":
        return EeDelta(control_period)
    if action_space == "joint_delta":
        return JointDelta(control_period)
    if action_space == "joint_velocity":
        return JointVelocity(control_period)
    raise ConfigError(
        f"action_space={action_space!r} is unknown: give ee_delta, joint_delta or joint_velocity."
    )
