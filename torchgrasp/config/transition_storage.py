"""How a run stores what it learns from: the codec, a row of the buffer, the buffer itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.transforms import Transform

from torchgrasp import keys
from torchgrasp.config.demonstration_sources import count_steps, list_read
from torchgrasp.config.kept_features import check_augmentation, keep_features
from torchgrasp.config.networks import check_state_inputs
from torchgrasp.config.parts import at_place, build
from torchgrasp.data import CompactTransitions
from torchgrasp.data.buffer_memory import check_space, count_row_bytes
from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.geometry import GOAL_SIZE
from torchgrasp.training import Experience

# Batches that are ready for a GPU: one while the other is learned from.
_AHEAD = 2


def make_experience(
    cfg: DictConfig,
    networks: Mapping[str, TensorDictModuleBase],
    shapes: Mapping[Any, tuple[int, ...]],
    *,
    own: str,
) -> Experience:
    """What a run learns from; refuses at once what would not fit the memory once it is collected.

    Args:
        cfg: the recipe's configuration.
        networks: by name; what they read is stored.
        shapes: of the observations, as `observed_shapes` tells them.
        own: name of the source that episodes are added to.
    """
    replay, kept = cfg.replay, keep_features(cfg, networks)
    augment, priority = build(replay.augment), build(replay.priority)
    given = codec = make_codec(cfg, networks.values(), made=kept.keys)
    if (features := kept.make_transform(augment)) is not None:
        options = {"feature_dtype": replay.get("feature_dtype", "float16"), "drop_keys": kept.drop_keys}
        codec = make_codec(cfg, networks.values(), made=kept.keys, features=features, **options)
        print(kept)
    row = make_row(codec, augment, shapes)
    check_state_inputs(cfg.model, shapes)
    capacity = 0 if cfg.offline.updates else int(replay.online_capacity)
    asked = count_steps(list_read(cfg).values())
    folder = None if replay.folder is None else str(replay.folder)  # a name of digits is read as a number
    with at_place("replay"):
        row_bytes = count_row_bytes(row, prioritised=priority is not None)
        check_space(capacity + asked, row_bytes, folder=folder)
    return Experience(
        own,
        capacity=capacity,
        row=row,
        given_row=make_row(given, None, shapes),
        codec=codec,
        batch_size=replay.batch_size,
        own_share=replay.online_fraction,
        seed=cfg.seed,
        augment=augment,
        priority=priority,
        folder=folder,
        device=cfg.device,
        ahead=_AHEAD if torch.device(cfg.device).type == "cuda" else 0,
    )


def make_codec(
    cfg: DictConfig, networks: Iterable[TensorDictModuleBase], *, made: Iterable = (), **options: Any
) -> CompactTransitions:
    """How transitions are stored: `replay.codec`, the goal as a state where a network reads it.

    What the networks read must be given, but for what is `made` of it.
    """
    read = {key for each in networks for key in each.in_keys}
    states = list(cfg.replay.codec.state_keys)
    states += [keys.GOAL] * (keys.GOAL in read and keys.GOAL not in states)
    codec = build(cfg.replay.codec, state_keys=states, **options)
    if absent := read - {keys.ACTION, *made} - set(codec.given_keys):
        raise ConfigError(
            f"The networks of `model` read {sorted(map(str, absent))}, which the replay buffer lacks: "
            "choose what goes together, such as model=pointnet2 with replay=mixture, or model=resnet18 with "
            "replay=images and transforms=rgbd; replay.codec.state_keys must name model.state_inputs."
        )
    return codec


def make_row(
    codec: CompactTransitions, augment: Transform | None, shapes: Mapping[Any, tuple[int, ...]]
) -> TensorDictBase:
    """A stored transition of observations of those shapes.

    Read back and augmented once, so that what cannot be augmented is refused before anything is collected.
    """
    shapes = {**shapes, keys.GOAL: (GOAL_SIZE,)}
    if absent := [key for key in codec.given_keys if key not in shapes]:
        raise ConfigError(
            f"The transforms write no {absent}, which replay.codec stores: keep transforms.points, choose "
            "transforms=rgb, rgbd or rgbdm with replay=images, and where table_plane is absent add "
            "'+transforms.table={_target_: torchgrasp.transforms.TablePlane}' (where wrist_angle is, "
            "transforms.wrist and WristAngle), or do without by model.table_input=false "
            "model.state_inputs=null 'replay.codec.state_keys=[time_left]'."
        )
    row = codec.example_row(shapes)
    if augment is not None:
        try:
            check_augmentation(augment, codec.features, codec(row.copy()), shapes)
            augment(codec(row.copy()))
        except TorchgraspError as error:
            raise type(error)(f"replay.augment: {error}") from error
    return row
