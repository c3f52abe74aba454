"""Where an arm may go and how fast: what is too fast is shortened, what lies outside stops the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from torchgrasp.errors import ConfigError, StopError, check_range
from torchgrasp.objects.gripper import lowest_point
from torchgrasp.sim.kinematics import JOINT_LOWER, JOINT_UPPER, forward_kinematics
from torchgrasp.sim.tracking import track_within_limits

Bounds = tuple[tuple[float, ...], tuple[float, ...]]
# Lower and upper angles of the seven joints, rad; the FR3's are those of its data sheet.
FR3_JOINTS: Bounds = (
    (-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159),
    (2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159),
)
PANDA_JOINTS: Bounds = (tuple(JOINT_LOWER.tolist()), tuple(JOINT_UPPER.tolist()))

# Shares of the way and of the turn that are tried where a joint's limit is in the way.
_MISSED = 0.005  # metres from a pose at which the arm does not come there
_SHARES = ((1.0, 1.0), (1.0, 0.75), (1.0, 0.5), (1.0, 0.25), (1.0, 0.0), (0.5, 0.0))


@dataclass(frozen=True)
class ArmLimits:
    """Limits of one arm in its place; base frame, metres, radians, seconds.

    Attributes:
        workspace: lower and upper corner (3,) of the box in which the hand's origin stays.
        table_height: of the table's top.
        clearance: of the open hand's lowest point above the table; the agent itself keeps 2 mm.
        speed: of the hand, m/s.
        turn_rate: of the hand, rad/s.
        acceleration: share of the robot's own largest acceleration (13 m/s2 of a Franka).
        lift_speed: m/s.
        joints: lower and upper angles of the arm: `FR3_JOINTS` or `PANDA_JOINTS`.
        joint_margin: rad from them at which the arm is stopped, before it stops itself.
        joint_torque: Nm of contact at a joint that the robot reacts to by stopping.
        force: N of contact at the hand that it reacts to by stopping.

    Example:
        >>> limits = ArmLimits(workspace=((0.2, -0.4, 0.0), (0.8, 0.4, 0.7)), speed=0.3)
        >>> away = np.eye(4)
        >>> away[:3, 3] = (0.5, 0.6, 0.3)
        >>> limits.check_pose(away)
        Traceback (most recent call last):
        ...
        torchgrasp.errors.StopError: the hand would be at y = 0.600 m, outside of the workspace's -0.4 to 0.4
    """

    workspace: Bounds = ((0.1, -0.65, 0.0), (0.85, 0.65, 1.0))
    table_height: float = 0.0
    clearance: float = 0.001
    speed: float = 0.5
    turn_rate: float = 2.0
    acceleration: float = 0.3
    lift_speed: float = 0.15
    joints: Bounds = FR3_JOINTS
    joint_margin: float = 0.02
    joint_torque: float = 40.0
    force: float = 50.0

    def __post_init__(self) -> None:
        check_range("table_height", self.table_height, -10.0, 10.0)
        check_range("clearance", self.clearance, 0.0, 0.1)
        check_range("joint_margin", self.joint_margin, 0.0, 1.0)
        check_range("acceleration", self.acceleration, 0.0, 1.0, open_low=True)
        # A Franka's own bounds.
        for name, high in (("speed", 1.7), ("lift_speed", 1.7), ("turn_rate", 2.5)):
            check_range(name, getattr(self, name), 0.0, high, open_low=True)
        for name in ("joint_torque", "force"):
            check_range(name, getattr(self, name), 0.0, 200.0, open_low=True)
        for name, size in (("workspace", 3), ("joints", 7)):
            _check_bounds(name, getattr(self, name), size)

    def check_joints(self, joints: ArrayLike) -> None:
        """Raise StopError where one of the (7,) angles is too near its limit."""
        lower, upper = (np.asarray(each) for each in self.joints)
        q = np.asarray(joints, dtype=np.float64)[:7]
        left = np.minimum(q - lower, upper - q)
        worst = int(np.argmin(left))
        if not left[worst] >= self.joint_margin:
            raise StopError(
                "limits",
                f"joint {worst + 1} at {q[worst]:.3f} rad is near or beyond its limits, {lower[worst]:.3f} "
                f"to {upper[worst]:.3f}",
            )

    def check_pose(self, T_base_ee: NDArray) -> None:
        """Raise StopError where the hand at (4, 4) leaves the workspace or comes too near the table."""
        for axis, place, low, high in zip("xyz", T_base_ee[:3, 3].tolist(), *self.workspace, strict=True):
            if not low <= place <= high:
                raise StopError(
                    "limits",
                    f"the hand would be at {axis} = {place:.3f} m, outside of the workspace's {low:g} to "
                    f"{high:g}",
                )
        if not np.isfinite(T_base_ee).all():
            raise StopError("limits", "the hand's pose has NaN or infinity")
        above = float(lowest_point(T_base_ee)) - self.table_height
        if above < self.clearance:
            raise StopError(
                "limits",
                f"the hand would be {1000 * above:.1f} mm above the table, less than the "
                f"clearance of {1000 * self.clearance:.1f} mm",
            )

    def reach(self, joints: ArrayLike, T_base_target: NDArray) -> NDArray:
        """The (4, 4) pose on the way to a target to which the arm comes with its joints (7,) in their limits.

        A robot's Cartesian controller knows nothing of those limits. Where one is in the way the hand goes
        where it is sent and turns as far as it can, as in training; else it goes part of the way, or stays.
        """
        lower, upper = (np.asarray(each) for each in self.joints)
        spare, free = 2 * self.joint_margin, np.full(7, np.inf)
        q = np.asarray(joints, dtype=np.float64)[None, :7]
        here = forward_kinematics(q)[0]
        for way, turn in _SHARES:
            pose = _go_part(here, T_base_target, way, turn)
            found, _ = track_within_limits(q, pose[None], lower=-free, upper=free)
            left = forward_kinematics(found)[0, :3, 3] - pose[:3, 3]
            if np.linalg.norm(left) > _MISSED:
                continue
            nearer = np.minimum(found - lower, upper - found) > np.minimum(q - lower, upper - q)
            if (nearer | ((found > lower + spare) & (found < upper - spare))).all():
                return pose
        return here

    def shorten(self, T_base_ee: NDArray, T_base_target: NDArray, seconds: float) -> NDArray:
        """The (4, 4) pose on the way to a target that the hand reaches within its speeds in `seconds`."""
        way = T_base_target[:3, 3] - T_base_ee[:3, 3]
        turn = Rotation.from_matrix(T_base_ee[:3, :3].T @ T_base_target[:3, :3]).as_rotvec()
        need = max(
            float(np.linalg.norm(way)) / (self.speed * seconds),
            float(np.linalg.norm(turn)) / (self.turn_rate * seconds),
        )
        if need <= 1.0:
            return T_base_target
        return _go_part(T_base_ee, T_base_target, 1 / need, 1 / need)


def _go_part(T_base_ee: NDArray, T_base_target: NDArray, way: float, turn: float) -> NDArray:
    """The (4, 4) pose after shares of the way and of the turn from one pose to another."""
    if way == turn == 1.0:
        return T_base_target
    pose = T_base_ee.copy()
    pose[:3, 3] += way * (T_base_target[:3, 3] - T_base_ee[:3, 3])
    whole = Rotation.from_matrix(T_base_ee[:3, :3].T @ T_base_target[:3, :3]).as_rotvec()
    pose[:3, :3] = T_base_ee[:3, :3] @ Rotation.from_rotvec(turn * whole).as_matrix()
    return pose


def _check_bounds(name: str, bounds: Bounds, size: int) -> None:
    try:
        pair = np.asarray(bounds, dtype=np.float64)
        ordered = pair.shape == (2, size) and bool((pair[0] < pair[1]).all())
    except (TypeError, ValueError):
        ordered = False
    if not ordered:
        raise ConfigError(f"{name}={bounds}: give {size} lower numbers and {size} upper ones above them.")
