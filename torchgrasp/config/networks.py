"""The networks of a configuration, and trained ones from a run directory or weights file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModuleBase

from torchgrasp.config.parts import build
from torchgrasp.config.weights_files import weights_file
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.modules.goal_keys import reads_goal
from torchgrasp.runs import load_weights

_NETWORKS = ("actor", "critic", "goal_network")


def make_networks(model: DictConfig, *, critic: bool = True) -> dict[str, TensorDictModuleBase]:
    """Actor, critic and, where the actor reads the goal, the network that predicts it, by name."""
    networks = {"actor": build(model.actor)}
    if critic:
        networks["critic"] = build(model.critic)
    if reads_goal(networks["actor"]):
        networks["goal_network"] = build(model.goal_network)
    return networks


def load_acting(path: Path, *, critic: bool = False) -> dict[str, TensorDictModuleBase]:
    """The trained networks that act, of a run directory or weights file; on demand the critic, if any."""
    states, config = load_weights(weights_file(path))
    cfg: Any = OmegaConf.create(config["model"])
    forget_encoder_files(cfg)
    networks = make_networks(cfg, critic=critic and "critic" in states)
    _give(networks, states, path)
    return networks


def forget_encoder_files(model: DictConfig) -> None:
    """Have no encoder of trained networks begin with a file of its own: it need not be there."""
    for name in _NETWORKS:
        if OmegaConf.select(model, f"{name}.encoder.weights") is not None:
            model[name].encoder.weights = None


def begin_networks(cfg: DictConfig, networks: Mapping[str, TensorDictModuleBase]) -> None:
    """Give the networks the weights that `init` names, if it does; refuse encoders frozen at random ones."""
    untrained = dict(networks)
    if cfg.init is not None:
        for name in load_networks(networks, Path(str(cfg.init))):
            del untrained[name]
    check_frozen(cfg.model, untrained)


def load_networks(networks: Mapping[str, TensorDictModuleBase], path: Path) -> list[str]:
    """Give the networks the weights of the same names in a run directory or weights file; returns the names.

    A critic stays as it is where imitation alone, which trains none, has left the file.
    """
    states, config = load_weights(weights_file(path))
    if config.get("recipe") == "bc" and "critic" in networks:
        print(f"{path} was trained by imitation: the critic begins anew.")
        networks = {name: each for name, each in networks.items() if name != "critic"}
    _give(networks, states, path)
    return list(networks)


def _give(
    networks: Mapping[str, TensorDictModuleBase], states: Mapping[str, Mapping[str, Any]], path: Path
) -> None:
    try:
        for name, network in networks.items():
            network.load_state_dict(states[name])
    except (KeyError, RuntimeError) as error:
        reason = str(error).splitlines()[-1].strip()
        raise CheckpointError(
            f"{path} holds weights of other networks ({reason}): choose the model that it was trained with."
        ) from error


def check_frozen(model: DictConfig, untrained: Iterable[str]) -> None:
    """Refuse to freeze encoders of the networks so named, which are at their random first weights."""
    for name in untrained:
        frozen = OmegaConf.select(model, f"{name}.freeze_encoder")
        if frozen and OmegaConf.select(model, f"{name}.encoder.weights") is None:
            raise ConfigError(
                f"model.{name}.freeze_encoder=true would keep random weights: add init=<run directory or "
                f"weights file> that has trained it, or model.{name}.freeze_encoder=false."
            )


def check_state_inputs(model: DictConfig, shapes: Mapping[Any, tuple[int, ...]]) -> None:
    """Refuse further observations of another size than the environment's, whose shapes are given."""
    for network in _NETWORKS:
        for key, size in (OmegaConf.select(model, f"{network}.state_inputs") or {}).items():
            if key in shapes and shapes[key] != (size,):
                raise ConfigError(
                    f"model.{network}.state_inputs: {key}={size}, but {key} has the shape {shapes[key]}: "
                    "give the size of its only dimension."
                )
