"""What a network has to do with the goal, by the keys that it reads and writes (Table 2)."""

from __future__ import annotations

from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys


def reads_goal(network: TensorDictModuleBase) -> bool:
    """Whether the goal is among a network's inputs."""
    return keys.GOAL in network.in_keys


def predicts_goal(network: TensorDictModuleBase) -> bool:
    """Whether a network has a goal head (the auxiliary task)."""
    return keys.GOAL_PREDICTION in network.out_keys
