"""The networks of a configuration, and the policy that they make together."""

from __future__ import annotations

from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModuleBase, TensorDictSequential

from torchgrasp import keys


def reads_goal(network: TensorDictModuleBase) -> bool:
    """Whether the goal is among a network's inputs."""
    return keys.GOAL in network.in_keys


def predicts_goal(network: TensorDictModuleBase) -> bool:
    """Whether a network has a goal head (the auxiliary task)."""
    return keys.GOAL_PREDICTION in network.out_keys


def make_networks(model: DictConfig) -> dict[str, TensorDictModuleBase]:
    """Actor, critic and, where the actor reads the goal, the network that predicts it, by name."""
    networks = {"actor": instantiate(model.actor), "critic": instantiate(model.critic)}
    if reads_goal(networks["actor"]):
        networks["goal_network"] = instantiate(model.goal_network)
    return networks


def make_acting(model: dict[str, Any]) -> dict[str, TensorDictModuleBase]:
    """The networks that act, for weights to be loaded: no encoder starts from a file of its own."""
    cfg: Any = OmegaConf.create(model)
    for name in ("actor", "goal_network"):
        if OmegaConf.select(cfg, f"{name}.encoder.weights") is not None:
            cfg[name].encoder.weights = None
    actor = instantiate(cfg.actor)
    return {"actor": actor} | ({"goal_network": instantiate(cfg.goal_network)} if reads_goal(actor) else {})


def join_policy(networks: dict[str, TensorDictModuleBase]) -> TensorDictModuleBase:
    """What acts where no expert tells the goal: the actor, behind the goal network if there is one."""
    if "goal_network" not in networks:
        return networks["actor"]
    modules: list = [networks["goal_network"], networks["actor"]]
    return TensorDictSequential(*modules)
