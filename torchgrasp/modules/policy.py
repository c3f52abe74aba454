"""The networks that act, joined to one policy."""

from __future__ import annotations

from collections.abc import Mapping

from tensordict.nn import TensorDictModuleBase, TensorDictSequential

from torchgrasp.modules.mirrored_policy import Mirror, MirroredPolicy


def join_policy(
    networks: Mapping[str, TensorDictModuleBase], mirror: Mirror | None = None
) -> TensorDictModuleBase:
    """What acts where no expert tells the goal: `actor`, behind `goal_network` if there is one.

    Args:
        networks: by name.
        mirror: to act by the mean over reflections, see `MirroredPolicy`.
    """
    policy = networks["actor"]
    if "goal_network" in networks:
        modules: list = [networks["goal_network"], policy]
        policy = TensorDictSequential(*modules)
    return policy if mirror is None else MirroredPolicy(policy, mirror)
