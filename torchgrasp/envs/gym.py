"""GraspEnv under a Gymnasium id: `gymnasium.make("torchgrasp.gym:torchgrasp/Grasp-v0")`.

TorchRL's own `register_gym` is not used: its wrapper's `reset` takes neither seed nor options, and it hands
out torch tensors with a batch dimension for reward and flags, which Gymnasium's checker refuses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import Compose, Transform, TransformedEnv
from torchrl.envs.utils import step_mdp

from torchgrasp import keys
from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import Camera
from torchgrasp.transforms import AggregatePoints, AppendGripperPoints, DepthToPoints, SamplePoints

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:
    raise ImportError('torchgrasp.gym needs Gymnasium: pip install "torchgrasp[gym]"') from error

ENV_ID = "torchgrasp/Grasp-v0"
# What a policy may read; poses of the target are privileged.
_OBSERVED = (keys.POINTS, keys.JOINTS, keys.TIME_LEFT)


class GymGrasp(gymnasium.Env):
    """One world of GraspEnv, with the point cloud of Sec. 6.2, by Gymnasium's interface.

    Observations are a dictionary of float32 arrays: ``points`` (num_points + 6, 4), ``joints`` (9,) and
    ``time_left`` (1,); actions are (6,), metres and radians, in the bounds of the space. `info` has
    ``success``, ``episode`` and ``object``, the target's name. ``reset(seed=s)`` begins episode 0 of seed
    s; without a seed the next episode follows. ``options={"episode": n}`` chooses one.

    Args:
        objects: what is grasped; the procedural training objects by default.
        camera: the wrist camera; ray casting by default.
        horizon: steps of an episode.
        num_points: observed points; six of the gripper are added.
        alpha: of AggregatePoints.
        seed: of the episodes until `reset` gives one.
        transforms: takes the place of the whole chain from picture to points.

    Example:
        >>> from torchgrasp.objects import ProceduralObjects
        >>> objects = ProceduralObjects("train", num_objects=1, num_grasps=100)
        >>> env = gymnasium.make("torchgrasp/Grasp-v0", objects=objects, horizon=3)
        >>> observation, info = env.reset(seed=0)
        >>> observation["points"].shape
        (1030, 4)
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own way; recipes/evaluate.py makes videos)

    def __init__(
        self,
        *,
        objects: Sequence[GraspObject] | None = None,
        camera: Camera | None = None,
        horizon: int = 30,
        num_points: int = 1024,
        alpha: float = 0.95,
        seed: int = 0,
        transforms: Transform | None = None,
    ) -> None:
        objects = ProceduralObjects("train") if objects is None else objects
        self._grasp = GraspEnv(1, objects=objects, camera=camera, horizon=horizon, seed=seed)
        if transforms is None:
            fov = self._grasp.cameras["camera"].intrinsics.fov
            chain = [DepthToPoints(fov=fov), AggregatePoints(alpha), SamplePoints(num_points)]
            transforms = Compose(*chain, AppendGripperPoints())  # pyright: ignore[reportCallIssue]
        self._env = TransformedEnv(self._grasp, transforms)
        seen = self._env.observation_spec
        if keys.POINTS not in set(seen.keys()):
            raise ConfigError("The transforms of GymGrasp write no 'points': give a chain that does.")
        self.observation_space = spaces.Dict(
            {
                keys.POINTS: _box(-np.inf, np.inf, seen[keys.POINTS].shape[1:]),
                keys.JOINTS: _box(-np.inf, np.inf, (9,)),
                keys.TIME_LEFT: _box(0.0, 1.0, (1,)),
            }
        )
        bound = np.array(self._grasp.actions.bound, dtype=np.float32)
        self.action_space = spaces.Box(-bound, bound, dtype=np.float32)
        self._state: TensorDictBase | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        """Begin an episode; its observation and info."""
        super().reset(seed=seed)
        if seed is not None:
            self._env.set_seed(seed)
            self._grasp.start_episodes_at([0])
        if options and "episode" in options:
            self._grasp.start_episodes_at([int(options["episode"])])
        self._state = self._env.reset()
        return self._observed(self._state), self._info(self._state, success=False)

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """One step; observation, reward, terminated, truncated, info."""
        if self._state is None:
            raise ConfigError("GymGrasp needs reset() before its first step.")
        action = np.asarray(action, dtype=np.float32)
        if action.shape != self.action_space.shape:
            raise ConfigError(f"GymGrasp was given an action of shape {action.shape}: give (6,).")
        after = self._env.step(self._state.set(keys.ACTION, torch.from_numpy(action)[None]))
        self._state, after = step_mdp(after), after["next"]
        reward = float(after["reward"])
        info = self._info(after, success=reward > 0)
        return self._observed(after), reward, bool(after["terminated"]), bool(after["truncated"]), info

    def close(self) -> None:
        """End the environment."""
        if not self._env.is_closed:
            self._env.close()

    def _observed(self, state: TensorDictBase) -> dict[str, np.ndarray]:
        return {key: state.get(key)[0].numpy().copy() for key in _OBSERVED}

    def _info(self, state: TensorDictBase, *, success: bool) -> dict[str, Any]:
        target = self._grasp.objects[int(state.get(keys.OBJECT_ID))]
        return {"success": success, "episode": int(state.get(keys.EPISODE)), "object": target.name}


def _box(low: float, high: float, shape: Sequence[int]) -> spaces.Box:
    return spaces.Box(low, high, tuple(shape), dtype=np.float32)


def register() -> None:
    """Make ENV_ID known to Gymnasium, as importing this module does."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(ENV_ID, entry_point="torchgrasp.gym:GymGrasp")


register()
