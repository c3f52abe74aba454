"""The networks of a configuration, and trained ones from a run directory or weights file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.config.parts import at_place, build
from torchgrasp.config.residual import has_residual, without_residual
from torchgrasp.config.weights_files import TrainedWeights, read_trained
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.modules import ACTOR_FEATURE, GivenFeature, ResidualPolicy
from torchgrasp.modules.goal_keys import reads_goal
from torchgrasp.transforms import RandomMirror

_NETWORKS = ("actor", "critic", "goal_network")


def make_networks(
    model: DictConfig, *, critic: bool = True, base: TensorDictModuleBase | None = None
) -> dict[str, TensorDictModuleBase]:
    """Actor, critic and, where the actor reads the goal, the network that predicts it, by name.

    With `model.residual` the actor is a ResidualPolicy on `base`, or on a new actor without it, and the
    critic reads the feature of its encoder.
    """
    actor = build(model.actor) if base is None else base
    networks = {"actor": actor}
    if (residual := model.get("residual")) is not None:
        with at_place("model.residual"):
            actor = networks["actor"] = ResidualPolicy(actor, **residual)
    if critic:
        networks["critic"] = build(model.critic, **_share_encoder(actor))
    if reads_goal(networks["actor"]):
        networks["goal_network"] = build(model.goal_network)
    return networks


def make_mirror(model: Mapping[Any, Any]) -> RandomMirror | None:
    """What the policy of a model acts by the mean over, None where it acts as it is."""
    return RandomMirror() if model.get("mirrored") else None


def _share_encoder(actor: TensorDictModuleBase) -> dict[str, Any]:
    """The options of a critic on the feature of a residual's encoder; of any other actor, none."""
    if not isinstance(actor, ResidualPolicy):
        return {}
    encoder, in_keys = GivenFeature(actor.feature_size), [ACTOR_FEATURE, keys.TIME_LEFT, keys.ACTION]
    return {"encoder": encoder, "fusion": "late", "freeze_encoder": False, "in_keys": in_keys}


def load_base(cfg: DictConfig) -> TensorDictModuleBase | None:
    """The actor that `init` names, to be corrected; None where it has a residual of its own."""
    trained = read_trained(Path(str(cfg.init)), cfg.trust)
    if has_residual(trained.config):
        return None
    networks = make_networks(without_residual(cfg).model, critic=False)
    load_networks(networks, trained)
    return networks["actor"]


def rebuild_acting(trained: TrainedWeights, *, critic: bool = False) -> dict[str, TensorDictModuleBase]:
    """The trained networks that act; on demand the critic, if there is one."""
    cfg: Any = OmegaConf.create({"model": trained.config["model"]})
    forget_encoder_files(cfg.model)
    critic = critic and "critic" in trained.states
    with torch.device("meta"):  # sizes are compared before anything of that size is allocated
        _check_sizes(make_networks(cfg.model, critic=critic), trained)
    networks = make_networks(cfg.model, critic=critic)
    _give(networks, trained)
    return networks


def without_correction(trained: TrainedWeights) -> TrainedWeights:
    """The trained weights with the actor as it was before it was corrected, if it was.

    The critic, which reads what the corrected actor's encoder writes, is left out then.
    """
    if not has_residual(trained.config):
        return trained
    states = {name: each for name, each in trained.states.items() if name != "critic"}
    states["actor"] = ResidualPolicy.find_corrected(trained.states.get("actor", {}))
    model = {**trained.config["model"], "residual": None}
    return replace(trained, states=states, config={**trained.config, "model": model})


def forget_encoder_files(model: DictConfig) -> None:
    """Have no encoder of trained networks begin with a file of its own: it need not be there."""
    for name in _NETWORKS:
        if OmegaConf.select(model, f"{name}.encoder.weights") is not None:
            model[name].encoder.weights = None


def begin_networks(cfg: DictConfig, networks: Mapping[str, TensorDictModuleBase]) -> None:
    """Give the networks the weights that `init` names, if it does; refuse encoders frozen at random ones."""
    untrained = dict(networks)
    if cfg.init is not None:
        for name in load_networks(networks, read_trained(Path(str(cfg.init)), cfg.trust)):
            del untrained[name]
    if "actor" in untrained and has_residual(cfg):
        raise ConfigError(
            "model.residual corrects a trained actor, and there is none: add init=<run directory or weights "
            "file>, or imitation before it by pretrain.steps, or leave it out by model.residual=null."
        )
    check_frozen(cfg.model, untrained)


def load_networks(networks: Mapping[str, TensorDictModuleBase], trained: TrainedWeights) -> list[str]:
    """Give the networks the trained weights of the same names; returns the names.

    A critic stays as it is where imitation alone, which trains none, has left the file. An actor without a
    correction begins as it was before its correction. That one's critic reads other features, and stays out.
    """
    cause = "was trained by imitation"
    if has_residual(trained.config) and not isinstance(networks["actor"], ResidualPolicy):
        trained, cause = without_correction(trained), "holds the critic of a correction"
        print(f"{trained.path} has been corrected: without model.residual the actor begins as it was before.")
    if "critic" in networks and "critic" not in trained.states:
        print(f"{trained.path} {cause}: the critic begins anew.")
        networks = {name: each for name, each in networks.items() if name != "critic"}
    _check_sizes(networks, trained)
    _give(networks, trained)
    return list(networks)


def _give(networks: Mapping[str, TensorDictModuleBase], trained: TrainedWeights) -> None:
    for name, network in networks.items():
        network.load_state_dict(trained.states[name])


def _check_sizes(networks: Mapping[str, TensorDictModuleBase], trained: TrainedWeights) -> None:
    """Refuse trained weights that are not of the networks of the same names, by the first that differs."""
    for name, network in networks.items():
        ours = {key: tuple(value.shape) for key, value in network.state_dict().items()}
        theirs = {key: tuple(value.shape) for key, value in trained.states.get(name, {}).items()}
        if ours != theirs:
            key = next(key for key in {**ours, **theirs} if ours.get(key) != theirs.get(key))
            raise CheckpointError(
                f"{trained.path} holds weights of other networks ({key} is {theirs.get(key)}, not "
                f"{ours.get(key)}): choose the model that it was trained with."
            )


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
