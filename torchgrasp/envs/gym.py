"""GraspEnv by Gymnasium's interface; importing this registers `torchgrasp/Grasp-v0`.

`gymnasium.make("torchgrasp.envs.gym:torchgrasp/Grasp-v0", policy="pretrained")` imports it by itself.

TorchRL's own `register_gym` is not used: its wrapper's `reset` takes neither seed nor options, and it hands
out torch tensors with a batch dimension for reward and flags, which Gymnasium's checker refuses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import step_mdp

from torchgrasp import keys
from torchgrasp.envs.grasp import GraspEnv
from torchgrasp.errors import ConfigError

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:
    raise ImportError('torchgrasp.envs.gym needs Gymnasium: pip install "torchgrasp[gym]"') from error

ENV_ID = "torchgrasp/Grasp-v0"


class GymGrasp(gymnasium.Env):
    """One world of GraspEnv, usually with transforms around it.

    Observations are a dictionary of float32 arrays; actions are those of the environment, within the bounds
    of the space. `info` has ``success``, ``episode`` and ``object``, the target's name. ``reset(seed=s)``
    begins episode 0 of seed s; without a seed the next episode follows. ``options={"episode": n}`` chooses.

    Args:
        env: a GraspEnv of one world, or a TransformedEnv around one.
        observed: keys that make up the observation; poses of the target are privileged.

    Example:
        >>> from torchgrasp.objects import ProceduralObjects
        >>> objects = ProceduralObjects("train", num_objects=1, num_grasps=100)
        >>> env = GymGrasp(GraspEnv(1, objects=objects, horizon=3))
        >>> observation, info = env.reset(seed=0)
        >>> {name: array.shape for name, array in observation.items()}
        {'joints': (9,), 'time_left': (1,)}
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own way; films are made by torchgrasp.report)

    def __init__(
        self,
        env: GraspEnv | TransformedEnv,
        *,
        observed: Sequence[str] = (keys.JOINTS, keys.TIME_LEFT),
    ) -> None:
        base = env.base_env if isinstance(env, TransformedEnv) else env
        if not isinstance(base, GraspEnv):
            told = type(base).__name__
            raise ConfigError(f"env is a {told}: give a GraspEnv, or a TransformedEnv around one.")
        if env.batch_size != torch.Size([1]):
            raise ConfigError(f"env has {env.batch_size.numel()} worlds: give one world, num_envs=1.")
        self._env: EnvBase = env
        self._grasp, self._observed_keys = base, tuple(dict.fromkeys(observed))
        seen = env.observation_spec
        if absent := [key for key in self._observed_keys if key not in set(seen.keys())]:
            raise ConfigError(f"observed names {absent}, which env does not write: add transforms that do.")
        self.observation_space = spaces.Dict(
            {key: _box(*_bounds(key), seen[key].shape[1:]) for key in self._observed_keys}
        )
        bound = np.array(base.actions.bound, dtype=np.float32)
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
            raise ConfigError(f"action has the shape {action.shape}: give {self.action_space.shape}.")
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
        return {key: state.get(key)[0].numpy().copy() for key in self._observed_keys}

    def _info(self, state: TensorDictBase, *, success: bool) -> dict[str, Any]:
        target = self._grasp.objects[int(state.get(keys.OBJECT_ID))]
        return {"success": success, "episode": int(state.get(keys.EPISODE)), "object": target.name}


def _bounds(key: str) -> tuple[float, float]:
    return (0.0, 1.0) if key == keys.TIME_LEFT else (-np.inf, np.inf)


def _box(low: float, high: float, shape: Sequence[int]) -> spaces.Box:
    return spaces.Box(low, high, tuple(shape), dtype=np.float32)


def register() -> None:
    """Make ENV_ID known to Gymnasium, as importing this module does: the environment of a trained policy."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(ENV_ID, entry_point="torchgrasp.config.gym_env:make_gym_env")


register()
