"""What stands behind Gymnasium's id `torchgrasp/Grasp-v0`: the environment of a trained policy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from torchgrasp import keys
from torchgrasp.config.trained_policy import TrainedPolicy, load_policy, make_env
from torchgrasp.envs import Start, TargetMotion
from torchgrasp.envs.gym import GymGrasp
from torchgrasp.objects import GraspObject
from torchgrasp.sim import Engine, EngineName, Physics


def make_gym_env(
    policy: TrainedPolicy | str | Path = "pretrained",
    *,
    objects: Sequence[GraspObject] | None = None,
    seed: int | None = None,
    start: Start | None = None,
    physics: Physics | None = None,
    engine: Engine | EngineName = "sapien",
    target_motion: TargetMotion | Literal["static", "jitter", "handover", "mixed"] = "static",
    object_order: Literal["random", "cycle"] = "random",
) -> GymGrasp:
    """One world of `torchgrasp.make_env` by Gymnasium's interface; observations are what the policy reads.

    Joints (9,) stand beside them. Arguments are those of `torchgrasp.make_env`.

    Example:
        >>> import gymnasium
        >>> from torchgrasp.envs.gym import ENV_ID
        >>> from torchgrasp.objects import ProceduralObjects
        >>> objects = ProceduralObjects("test", num_objects=1, num_grasps=100)
        >>> env = gymnasium.make(ENV_ID, policy="pretrained", objects=objects)
        >>> observation, info = env.reset(seed=0)
        >>> sorted(observation)
        ['joints', 'points', 'table_plane', 'time_left', 'wrist_angle']
    """
    trained = policy if isinstance(policy, TrainedPolicy) else load_policy(policy)
    env = make_env(
        trained,
        objects=objects,
        seed=seed,
        start=start,
        physics=physics,
        engine=engine,
        target_motion=target_motion,
        object_order=object_order,
    )
    observed = [str(key) for key in trained.in_keys if key in env.observation_spec.keys(True, True)]
    return GymGrasp(env, observed=(*observed, keys.JOINTS))
