"""PoseNoise: where an object seems to be, by a pose estimate that is a little wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from torchgrasp.errors import ConfigError, check_range
from torchgrasp.sim.kinematics import Array


@dataclass(frozen=True)
class PoseNoise:
    """The error of an estimated object pose.

    Attributes:
        translation: metres, of each component in the base frame: the standard deviation, or the most of a
            uniform error.
        rotation: radians, the same of the angle about an axis of any direction through the object's origin.
        distribution: ``gaussian`` or ``uniform``.
    """

    translation: float = 0.01
    rotation: float = float(np.deg2rad(5.0))
    distribution: Literal["gaussian", "uniform"] = "gaussian"

    def __post_init__(self) -> None:
        check_range("translation", self.translation, 0.0, np.inf)
        check_range("rotation", self.rotation, 0.0, np.pi)
        if self.distribution not in ("gaussian", "uniform"):
            raise ConfigError(f"distribution={self.distribution!r} is unknown: give gaussian or uniform.")

    def perceive(self, T_base_object: Array, rng: np.random.Generator) -> Array:
        """The (4, 4) pose told of an object that is at T_base_object (4, 4)."""
        axis = rng.standard_normal(3)
        errors = rng.standard_normal(4) if self.distribution == "gaussian" else rng.uniform(-1.0, 1.0, 4)
        turn = Rotation.from_rotvec(self.rotation * errors[3] * axis / np.linalg.norm(axis))
        seen = T_base_object.copy()
        seen[:3, 3] += self.translation * errors[:3]
        seen[:3, :3] = turn.as_matrix() @ seen[:3, :3]
        return seen
