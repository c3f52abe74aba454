"""What a planning policy reads of a batch: one row a world, in numpy, whatever the batch's shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.sim.kinematics import Array

# What `WorldStates.read` needs.
STATE_KEYS = (
    *(keys.T_BASE_EE, keys.T_BASE_OBJECT, keys.OBJECT_ID, keys.WORLD, keys.EPISODE),
    *(keys.JOINTS, keys.TIME_LEFT),
)


@dataclass(frozen=True)
class WorldStates:
    """The states of N worlds.

    Attributes:
        T_base_ee: (N, 4, 4) hand poses.
        T_base_object: (N, 4, 4) object poses.
        q: (N, 7) arm angles, radians.
        steps_left: (N,) control steps until the fingers close, at least 1.
        worlds: N numbers of the worlds.
        episodes: N pairs (object, episode), which name an episode in its world.
    """

    T_base_ee: Array
    T_base_object: Array
    q: Array
    steps_left: Array
    worlds: list[int]
    episodes: list[tuple[int, int]]

    @classmethod
    def read(cls, tensordict: TensorDictBase, horizon: int) -> WorldStates:
        """The states in a batch (*), flat; `horizon` is the environment's T."""
        size = len(tensordict.batch_size)
        n = tensordict.batch_size.numel()
        state = {
            key: entry.detach().reshape(n, *entry.shape[size:]).cpu().numpy()
            for key, entry in ((key, tensordict.get(key)) for key in STATE_KEYS)
        }
        objects, episodes = state[keys.OBJECT_ID][:, 0], state[keys.EPISODE][:, 0]
        return cls(
            T_base_ee=state[keys.T_BASE_EE].astype(np.float64),
            T_base_object=state[keys.T_BASE_OBJECT].astype(np.float64),
            q=state[keys.JOINTS].astype(np.float64)[:, :7],
            steps_left=np.maximum(np.rint(state[keys.TIME_LEFT][:, 0] * horizon), 1.0),
            worlds=state[keys.WORLD][:, 0].tolist(),
            episodes=list(zip(objects.tolist(), episodes.tolist(), strict=True)),
        )
