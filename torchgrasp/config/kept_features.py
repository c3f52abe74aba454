"""Features of frozen encoders that the replay buffer keeps, and the networks that read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import NestedKey, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torchrl.envs.transforms import Compose, Transform

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.modules import ResidualPolicy, split_network
from torchgrasp.transforms import KeepFeatures

_TRIALS = 64


@dataclass(frozen=True)
class KeptFeatures:
    """Which networks learn on kept features.

    Attributes:
        networks: all of them by name, as losses take them: without their encoders where features are kept.
        encoders: of those, by name; they write ("features", <name>).
    """

    networks: dict[str, TensorDictModuleBase]
    encoders: dict[str, TensorDictModule]

    @property
    def keys(self) -> list[tuple[str, str]]:
        """Where the features are."""
        return [(keys.FEATURES, name) for name in self.encoders]

    @property
    def drop_keys(self) -> list[NestedKey]:
        """The clouds or pictures that nothing but these encoders reads."""
        read = {key for each in self.networks.values() for key in each.in_keys}
        seen = dict.fromkeys(each.in_keys[0] for each in self.encoders.values())
        return [key for key in seen if key not in read]

    def __str__(self) -> str:
        sizes = ", ".join(
            f"{name} {each.module.encoder.out_features}" for name, each in self.encoders.items()
        )
        read = set(self.keys)
        others = [name for name, each in self.networks.items() if not read & set(each.in_keys)]
        anew = f"; of {', '.join(others)} they are computed in each update" if others else ""
        return f"Features that are computed once a state and kept: {sizes} numbers{anew}"

    def make_transform(self, augment: Transform | None) -> KeepFeatures | None:
        """What makes the features, of every view that `augment` draws from; None where none are kept."""
        if not self.encoders:
            return None
        chosen = _find_viewing(augment)
        for each in chosen:
            each.feature_keys = tuple(
                key for name in self.keys for key in (name, unravel_key(("next", name)))
            )
        modules: list = list(self.encoders.values())
        return KeepFeatures(TensorDictSequential(*modules), views=chosen[0].views if chosen else ())


def keep_features(cfg: DictConfig, networks: Mapping[str, TensorDictModuleBase]) -> KeptFeatures:
    """Take the encoders out of the networks that `replay.keep_features` chooses.

    By `auto` these are all whose encoders are frozen and see the state alone; a list names them.
    """
    chosen = OmegaConf.select(cfg, "replay.keep_features")
    if chosen is None or chosen is False:
        names = []
    elif chosen == "auto":
        names = [name for name, each in networks.items() if _is_frozen(each) and not _reads_action(each)]
    else:
        names = _check_names(cfg, chosen, networks)
    if any(isinstance(each, ResidualPolicy) and name not in names for name, each in networks.items()):
        raise ConfigError(
            f"replay.keep_features={chosen} with model.residual: the critic reads the actor's features, "
            "which only the replay buffer has. Give auto, or a list with actor."
        )
    rest, encoders = dict(networks), {}
    for name in names:
        encoders[name], rest[name] = _split(name, networks[name])
    return KeptFeatures(rest, encoders)


def _split(name: str, network: Any) -> tuple[TensorDictModule, TensorDictModuleBase]:
    """The encoder of a network, and the network without it."""
    if isinstance(network, ResidualPolicy):
        return network.encoder, network.residual
    return split_network(network, (keys.FEATURES, name))


def _check_names(cfg: DictConfig, chosen: Any, networks: Mapping[str, TensorDictModuleBase]) -> list[str]:
    names = list(chosen) if OmegaConf.is_list(chosen) else [chosen]
    for name in names:
        place = f"replay.keep_features={chosen}"
        if name not in networks:
            raise ConfigError(f"{place}: give auto, null, or a list of {', '.join(networks)}.")
        if not _is_frozen(networks[name]):
            raise ConfigError(
                f"{place}: the {name}'s encoder learns, so that its features change: add "
                f"model.{name}.freeze_encoder=true, or leave the {name} out."
            )
        if _reads_action(networks[name]):
            raise ConfigError(
                f"{place}: the {name}'s encoder sees the action (model.{name}.fusion=early), so that no "
                f"feature is the state's alone: leave the {name} out, or train it with fusion=late."
            )
    return names


def _is_frozen(network: Any) -> bool:
    if isinstance(network, ResidualPolicy):
        return True
    return bool(getattr(getattr(network, "module", None), "encoder_is_frozen", False))


def _reads_action(network: Any) -> bool:
    return bool(getattr(getattr(network, "module", None), "reads_action_early", False))


def _find_viewing(augment: Transform | None) -> list[Any]:
    """Those of an augmentation, which TorchRL's Compose may join, that tell their views."""
    found = [each for each in _list_parts(augment) if hasattr(each, "views")]
    if len(found) > 1:
        raise ConfigError(
            f"replay.augment has {len(found)} transforms with views, and features of all their combinations "
            "are too many to keep: leave one, or give replay.keep_features=null."
        )
    return found


def _list_parts(augment: Transform | None) -> list[Any]:
    return list(augment.transforms) if isinstance(augment, Compose) else [augment]


def check_augmentation(
    augment: Transform, features: Any, batch: TensorDictBase, shapes: Mapping[Any, tuple[int, ...]]
) -> None:
    """Refuse an augmentation that changes what kept features are made of and does not tell its views.

    Args:
        augment: of sampled batches.
        features: what makes the features; None where none are kept.
        batch: a transition (1), as it is sampled.
        shapes: of what is observed.
    """
    unseen = [each for each in _list_parts(augment) if not hasattr(each, "views")]
    if features is None or not unseen:
        return
    trial = batch.expand(_TRIALS).clone()
    with torch.random.fork_rng(devices=[]):
        for key in features.in_keys:
            trial.set(key, torch.rand(_TRIALS, *shapes[key]))
        before = trial.select(*features.in_keys).clone()
        for each in unseen:
            trial = each(trial)
    for key, value in before.items(True, True):
        if not torch.equal(value, trial[key]):
            raise ConfigError(
                f"replay.augment changes {key!r}, of which features are kept: give "
                "replay.keep_features=null, or an augmentation that tells its `views`, as RandomMirror does."
            )
