"""The networks of a configuration, the policy that they make together, and what they need stored."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from settings import weights_file
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.envs.transforms import Transform

from torchgrasp import keys
from torchgrasp.data import CompactTransitions
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.geometry import GOAL_SIZE
from torchgrasp.runs.weights import load_weights


def reads_goal(network: TensorDictModuleBase) -> bool:
    """Whether the goal is among a network's inputs."""
    return keys.GOAL in network.in_keys


def predicts_goal(network: TensorDictModuleBase) -> bool:
    """Whether a network has a goal head (the auxiliary task)."""
    return keys.GOAL_PREDICTION in network.out_keys


def make_networks(model: DictConfig, *, critic: bool = True) -> dict[str, TensorDictModuleBase]:
    """Actor, critic and, where the actor reads the goal, the network that predicts it, by name."""
    networks = {"actor": instantiate(model.actor)}
    if critic:
        networks["critic"] = instantiate(model.critic)
    if reads_goal(networks["actor"]):
        networks["goal_network"] = instantiate(model.goal_network)
    return networks


def load_acting(path: Path, *, critic: bool = False) -> dict[str, TensorDictModuleBase]:
    """The trained networks that act, of a run directory or weights file; on demand the critic, if any."""
    states, config = load_weights(weights_file(path))
    critic = critic and "critic" in states
    cfg: Any = OmegaConf.create(config["model"])
    forget_encoder_files(cfg)
    networks = make_networks(cfg, critic=critic)
    _give(networks, states, path)
    return networks


def forget_encoder_files(model: DictConfig) -> None:
    """Have no encoder of trained networks begin with a file of its own: it need not be there."""
    for name in ("actor", "critic", "goal_network"):
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


def join_policy(networks: dict[str, TensorDictModuleBase]) -> TensorDictModuleBase:
    """What acts where no expert tells the goal: the actor, behind the goal network if there is one."""
    if "goal_network" not in networks:
        return networks["actor"]
    modules: list = [networks["goal_network"], networks["actor"]]
    return TensorDictSequential(*modules)


def make_codec(cfg: DictConfig, networks: Mapping[str, TensorDictModuleBase]) -> CompactTransitions:
    """How transitions are stored: `replay.codec`, the goal as a state where a network reads it."""
    states = list(cfg.replay.codec.state_keys)
    read = {key for each in networks.values() for key in each.in_keys}
    states += [keys.GOAL] * (keys.GOAL in read and keys.GOAL not in states)
    codec = instantiate(cfg.replay.codec, state_keys=states)
    if absent := read - {keys.ACTION} - set(codec.observation_keys):
        raise ConfigError(
            f"The networks of `model` read {sorted(map(str, absent))}, which the replay buffer lacks: "
            "choose what goes together, such as model=pointnet2 with replay=mixture, or model=resnet18 with "
            "replay=images and transforms=rgbd; replay.codec.state_keys must name model.state_inputs."
        )
    return codec


def check_state_inputs(model: DictConfig, shapes: Mapping[Any, tuple[int, ...]]) -> None:
    """Refuse further observations of another size than the environment's, whose shapes are given."""
    for network in ("actor", "critic", "goal_network"):
        for key, size in (OmegaConf.select(model, f"{network}.state_inputs") or {}).items():
            if key in shapes and shapes[key] != (size,):
                raise ConfigError(
                    f"model.{network}.state_inputs: {key}={size}, but {key} has the shape {shapes[key]}: "
                    "give the size of its only dimension."
                )


def make_row(
    codec: CompactTransitions, augment: Transform | None, shapes: Mapping[Any, tuple[int, ...]]
) -> TensorDictBase:
    """A stored transition of observations of those shapes.

    Read back and augmented once, so that what cannot be augmented is refused before anything is collected.
    """
    shapes = {**shapes, keys.GOAL: (GOAL_SIZE,)}
    if absent := [key for key in codec.observation_keys if key not in shapes]:
        raise ConfigError(
            f"The transforms write no {absent}, which replay.codec stores: keep transforms.points, choose "
            "transforms=rgb, rgbd or rgbdm with replay=images, and where table_plane is absent add "
            "'+transforms.table={_target_: torchgrasp.transforms.TablePlane}' (where wrist_angle is, "
            "transforms.wrist and WristAngle), or do without by model.table_input=false "
            "model.state_inputs=null 'replay.codec.state_keys=[time_left]'."
        )
    row = codec.example_row(shapes)
    if augment is not None:
        augment(codec(row.copy()))
    return row
