"""Inverse kinematics that continues from where the arm stands: one step of the hand after another."""

from __future__ import annotations

import functools
import importlib
from typing import Any

import numpy as np

from torchgrasp.sim._sapien import load_sapien, sapien
from torchgrasp.sim.kinematics import JOINT_LOWER, JOINT_UPPER, Array, jacobian, link_poses, pose_error
from torchgrasp.sim.panda import Panda

_IDENTITY = np.eye(6)
_ARM = np.array([1] * 7 + [0, 0], dtype=np.int32)
# Weights of the pose error once a joint is at its stop: the hand goes where it is sent and turns as far as it
# can. At equal weights, a metre a radian, a wrist that cannot turn holds the whole hand back.
_POSITION_FIRST = np.array([1.0, 1.0, 1.0, 0.003, 0.003, 0.003])


def track_pose(
    q: Array, T_base_ee: Array, *, iterations: int = 12, damping: float = 1e-3, tolerance: float = 1e-5
) -> tuple[Array, Array]:
    """Inverse kinematics that continues smoothly from q: damped least squares within the limits.

    Pinocchio's Newton steps, which know no joint limits, come first; where they end outside of them, or
    nowhere, the same steps are taken here with the joints that meet a limit locked. In a step with a locked
    joint position comes before rotation.

    Args:
        q: (N, 7) joint angles to start from.
        T_base_ee: (N, 4, 4) hand poses to reach.
        iterations: Newton steps at most.
        damping: of the least squares; small, because targets lie a step away.
        tolerance: of the pose error (metres and radians) at which a row stops.

    Returns:
        (N, 7) joint angles within the limits and the (N,) largest component of the error left.
    """
    start = np.minimum(np.maximum(q, JOINT_LOWER), JOINT_UPPER)
    out, left = start.copy(), np.zeros(len(start))
    hard = []
    for row, (near, pose) in enumerate(zip(start, T_base_ee, strict=True)):
        found, error = _newton(near, pose, iterations, damping, tolerance)
        if found is None:
            hard.append(row)
        else:
            out[row], left[row] = found, error
    if hard:
        options: Any = {"iterations": iterations, "damping": damping, "tolerance": tolerance}
        out[hard], left[hard] = track_within_limits(start[hard], T_base_ee[hard], **options)
    return out, left


def track_within_limits(
    q: Array,
    T_base_ee: Array,
    *,
    lower: Array = JOINT_LOWER,
    upper: Array = JOINT_UPPER,
    iterations: int = 12,
    damping: float = 1e-3,
    tolerance: float = 1e-5,
) -> tuple[Array, Array]:
    """Damped least squares in which joints at a limit are locked, without any simulator; see `track_pose`.

    `lower` and `upper` are the joints' (7,) limits, rad; the other arguments are as there.
    """
    q = q.copy()
    active = np.arange(len(q))
    left = np.zeros(len(q))
    for i in range(iterations + 1):
        poses = link_poses(q[active])
        error = pose_error(poses[:, 7], T_base_ee[active])
        left[active] = np.abs(error).max(axis=-1)
        keep = left[active] > tolerance
        if i == iterations or not keep.any():
            break
        active, error, poses = active[keep], error[keep], poses[keep]
        q[active] = _least_squares_step(q[active], jacobian(poses), error, damping, lower, upper)
    return q, left


def _least_squares_step(
    q: Array, j: Array, error: Array, damping: float, lower: Array, upper: Array
) -> Array:
    """One damped step; joints that a limit stops are locked, the others take over, position first."""
    ridge = damping**2 * _IDENTITY
    locked = np.zeros(q.shape, dtype=bool)
    for _ in range(3):
        weight = np.where(locked.any(axis=-1, keepdims=True), _POSITION_FIRST, 1.0)[..., None]
        free = np.where(locked[:, None, :], 0.0, j) * weight
        transposed = free.transpose(0, 2, 1)
        step = transposed @ np.linalg.solve(free @ transposed + ridge, error[..., None] * weight)
        moved = q + step[..., 0]
        inside = np.minimum(np.maximum(moved, lower), upper)
        blocked = (moved != inside) & ~locked
        if not blocked.any():
            break
        locked |= blocked
    return inside


@functools.cache
def _model() -> tuple[Any, int]:
    """Pinocchio's model of the arm as SAPIEN brings it along, and the hand's index in it."""
    # Where a package named pinocchio is installed, SAPIEN's own `create_pinocchio_model` takes that and steps
    # in Python: several times slower, and with other numbers.
    load_sapien()
    exporter = importlib.import_module("sapien.wrapper.urdf_exporter")
    built_in = importlib.import_module("sapien.pysapien_pinocchio")
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])  # lives until the arm has been described
    panda = Panda(scene)
    articulation, names = panda.articulation, [link.name for link in panda.links]
    xml = exporter.export_kinematic_chain_urdf(articulation, force_fix_root=True)
    model = built_in.PinocchioModel(xml, [0.0, 0.0, -9.81])
    model.set_joint_order([f"joint_{each.child_link.index}" for each in articulation.active_joints])
    model.set_link_order([f"link_{link.index}" for link in articulation.links])
    return model, names.index("hand")


def _newton(
    q: Array, T_base_ee: Array, iterations: int, damping: float, tolerance: float
) -> tuple[Array | None, float]:
    """(7,) angles for one (4, 4) hand pose and the error left, or None where limits are in the way."""
    model, hand = _model()
    found, success, error = model.compute_inverse_kinematics(
        hand,
        sapien.Pose(T_base_ee),
        initial_qpos=np.concatenate((q, (0.0, 0.0))),
        active_qmask=_ARM,
        eps=tolerance,
        max_iterations=iterations,
        dt=1.0,
        damp=damping**2,
    )
    found = found[:7]
    inside = success and bool(((found >= JOINT_LOWER) & (found <= JOINT_UPPER)).all())
    return (found, float(np.abs(error).max())) if inside else (None, 0.0)
