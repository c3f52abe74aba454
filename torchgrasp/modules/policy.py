"""The networks that act, joined to one policy."""

from __future__ import annotations

from collections.abc import Mapping

from tensordict.nn import TensorDictModuleBase, TensorDictSequential


def join_policy(networks: Mapping[str, TensorDictModuleBase]) -> TensorDictModuleBase:
    """What acts where no expert tells the goal: `actor`, behind `goal_network` if there is one."""
    if "goal_network" not in networks:
        return networks["actor"]
    modules: list = [networks["goal_network"], networks["actor"]]
    return TensorDictSequential(*modules)
