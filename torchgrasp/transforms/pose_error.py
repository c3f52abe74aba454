"""CameraPoseError: a camera that is not quite where its calibration says."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation
from tensordict import TensorDictBase

from torchgrasp.errors import check_range
from torchgrasp.transforms.base import CameraName, PointTransform, camera_keys, read_rows, write_rows


class CameraPoseError(PointTransform):
    """Tells T_BASE_CAMERA (*, 4, 4) wrongly, by the same error throughout an episode.

    The picture stays that of the true camera: T' = T E with E a displacement and turn in the camera's
    frame, as an error of hand-eye calibration is. Points made of the picture are then off by E.

    Args:
        translation: most that the camera is displaced, metres; uniform in a ball.
        rotation: most that it is turned, radians; uniform up to that, about an axis of any direction.
        camera: whose pose, wrist or overhead.
        seed: of the draws.

    Example:
        >>> import torch; from tensordict import TensorDict
        >>> off = CameraPoseError(translation=0.01)(TensorDict({"T_base_camera": torch.eye(4)}))
        >>> 0 < off["T_base_camera"][:3, 3].norm() <= 0.01
        tensor(True)
    """

    simulates_sensor = True

    def __init__(
        self,
        *,
        translation: float = 0.005,
        rotation: float = 0.01,
        camera: CameraName = "wrist",
        seed: int = 0,
    ) -> None:
        check_range("translation", translation, 0.0, float("inf"))
        check_range("rotation", rotation, 0.0, math.pi)
        pose = camera_keys(camera).pose
        super().__init__(in_keys=[pose], out_keys=[pose], seed=seed, per_episode=True)
        self.translation, self.rotation = translation, rotation

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        (poses,) = read_rows(next_tensordict, *self.in_keys)
        errors = np.stack([self._error(rng) for rng in self._generators(next_tensordict)])
        write_rows(next_tensordict, self.out_keys[0], (poses @ errors).astype(np.float32))
        return next_tensordict

    def _error(self, rng: np.random.Generator) -> np.ndarray:
        """(4, 4) pose of the believed camera in the true camera's frame."""
        axes = rng.standard_normal((2, 3))
        shift, axis = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
        error = np.eye(4)
        error[:3, 3] = self.translation * np.cbrt(rng.random()) * shift
        error[:3, :3] = Rotation.from_rotvec(rng.uniform(0.0, self.rotation) * axis).as_matrix()
        return error
