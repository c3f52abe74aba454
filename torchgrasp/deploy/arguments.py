"""What somebody hands to GraspAgent, read as numbers and checked: poses, joints, ages, one value an arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from torchgrasp.deploy.limits import FR3_JOINTS, PANDA_JOINTS
from torchgrasp.errors import ConfigError
from torchgrasp.sim.kinematics import forward_kinematics

_FINGERS_OPEN = 0.04  # metres, of each finger
# Radians: as far as the joints of a Panda or of an FR3 turn, and a little more.
LOWEST = np.minimum(PANDA_JOINTS[0], FR3_JOINTS[0]) - 0.05
HIGHEST = np.maximum(PANDA_JOINTS[1], FR3_JOINTS[1]) + 0.05


def read_array(name: str, value: Any) -> np.ndarray:
    """Any array or tensor, of any device and type, as numpy has it.

    Raises:
        ConfigError: where it is none, such as rows of several lengths.
    """
    if isinstance(value, torch.Tensor):
        value = value.detach().cpu()
        value = (value.float() if value.dtype == torch.bfloat16 else value).numpy()
    try:
        return np.asarray(value)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} cannot be read as an array ({error}).") from error


def read_numbers(name: str, value: Any) -> np.ndarray:
    """Finite float64 numbers of any shape."""
    try:
        numbers = read_array(name, value).astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} cannot be read as numbers ({error}).") from error
    if not np.isfinite(numbers).all():
        raise ConfigError(f"{name} has NaN or infinity: the robot's state is not known, do not move.")
    return numbers


def read_poses(name: str, value: Any, num_arms: int | None = None) -> np.ndarray:
    """Rigid poses (N, 4, 4) of N arms, given as such, or as (4, 4) where `num_arms` is None."""
    pose = read_numbers(name, value)
    shape = (4, 4) if num_arms is None else (num_arms, 4, 4)
    if pose.shape != shape:
        raise ConfigError(f"{name} of shape {pose.shape}: give {shape}.")
    turn = pose[..., :3, :3]
    rigid = np.abs(turn @ turn.swapaxes(-1, -2) - np.eye(3)).max() < 1e-3 and (np.linalg.det(turn) > 0).all()
    if not rigid or np.abs(pose[..., 3, :] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
        raise ConfigError(
            f"{name} is no rigid pose: give a rotation, a translation in metres and the row 0 0 0 1."
        )
    return pose.reshape(-1, 4, 4)


def read_arms(
    joints: Any, T_base_ee: Any, num_arms: int | None
) -> tuple[list[np.ndarray] | list[None], np.ndarray]:
    """Joints (9,) of each of N arms, None where there are none, and the (N, 4, 4) poses of the hands."""
    if joints is None and T_base_ee is None:
        raise ConfigError("joints and T_base_ee are both missing: give one, from the same moment.")
    hands = None if T_base_ee is None else read_poses("T_base_ee", T_base_ee, num_arms)
    if joints is None:
        assert hands is not None
        return [None] * len(hands), hands
    q = read_numbers("joints", joints)
    batch = () if num_arms is None else (num_arms,)
    shapes = [(*batch, size) for size in (7, 9)]
    if q.shape not in shapes:
        raise ConfigError(f"joints of shape {q.shape}: give {shapes[0]}, or {shapes[1]} with fingers.")
    q = q.reshape(-1, q.shape[-1])
    _check_reach(q[:, :7])
    if hands is None:
        hands = forward_kinematics(q[:, :7])
    fingers = np.full((len(q), 2), _FINGERS_OPEN) if q.shape[1] == 7 else q[:, 7:]
    return list(np.concatenate((q[:, :7], fingers), axis=1)), hands


def _check_reach(q: np.ndarray) -> None:
    """Refuse angles (N, 7) that no such arm can have: degrees, another arm's, or none that were read."""
    outside = np.argwhere((q < LOWEST) | (q > HIGHEST))
    if len(outside):
        row, joint = outside[0]
        raise ConfigError(
            f"joints: joint {joint + 1} cannot stand at {q[row, joint]:.3f} rad on a Panda or FR3: give the "
            "arm's own angles in radians, or T_base_ee for another arm."
        )


def read_ages(age: Any, num_arms: int) -> np.ndarray:
    """(N,) seconds of one age or of N."""
    try:
        ages = read_array("age", age).astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"age={age!r} cannot be read as seconds.") from error
    if ages.shape not in ((), (num_arms,)):
        raise ConfigError(f"age of shape {ages.shape}: give seconds for all, or for each of {num_arms}.")
    if not (ages >= 0.0).all():
        raise ConfigError(f"age={age}: give seconds since the picture was taken, 0 or more.")
    return np.broadcast_to(ages, num_arms)


def read_rows(arms: Any, num_arms: int) -> list[int]:
    """Numbers of some of the arms."""
    rows = read_array("arms", arms)
    if rows.size == 0:
        return []
    if rows.ndim != 1 or rows.dtype.kind not in "iu" or rows.min() < 0 or rows.max() >= num_arms:
        raise ConfigError(f"arms={arms}: give a list of numbers from 0 to {num_arms - 1}.")
    return rows.tolist()


def each_arm(name: str, value: Any, num_arms: int | None) -> list:
    """What belongs to each arm: the value itself for the only one."""
    if num_arms is None:
        return [value]
    if isinstance(value, str | dict) or not hasattr(value, "__len__") or len(value) != num_arms:
        raise ConfigError(f"{name} is not of {num_arms} arms: give a first dimension of that length.")
    return list(value)
