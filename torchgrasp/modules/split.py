"""A network in two: the encoder, whose features of a state can be kept, and the rest, which reads them."""

from __future__ import annotations

from copy import copy
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn

from torchgrasp.errors import ConfigError, check_whole
from torchgrasp.modules.heads import EncoderNetwork
from torchgrasp.modules.network import GraspNetwork


class GivenFeature(nn.Module):
    """The encoder of a network that is given its features (*, F): hands them on.

    A network on the features of another is made of it, a critic for a frozen actor for instance.

    Args:
        out_features: F.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchgrasp.modules import GraspCritic
        >>> critic = GraspCritic(GivenFeature(64), fusion="late", in_keys=["feature", "time_left", "action"])
        >>> state = {"feature": torch.rand(2, 64), "time_left": torch.ones(2, 1)}
        >>> critic(TensorDict({**state, "action": torch.zeros(2, 6)}, [2]))["state_action_value"].shape
        torch.Size([2, 2])
    """

    channel_dim = None

    def __init__(self, out_features: int) -> None:
        super().__init__()
        check_whole("out_features", out_features, 1)
        self.out_features = out_features

    def forward(self, feature: Tensor) -> Tensor:
        """The features (*, F) themselves."""
        if feature.shape[-1] != self.out_features:
            raise ConfigError(
                f"features of shape {tuple(feature.shape)} do not go into a network on {self.out_features}: "
                "give those of the encoder that it was made for."
            )
        return feature


class _Look(EncoderNetwork):
    """The encoder alone; it keeps the parameters that the whole network has."""

    def freeze(self) -> None:
        """Keep the encoder as it is from now on."""
        self.encoder_is_frozen = True
        self.encoder.requires_grad_(False).eval()

    def forward(self, observed: Tensor, *plane: Tensor) -> Tensor:
        weight = next((p for p in self.encoder.parameters() if p.is_floating_point()), None)
        return self.look(observed, *plane, dtype=torch.float32 if weight is None else weight.dtype)


def split_network(
    network: TensorDictModuleBase, feature_key: NestedKey
) -> tuple[TensorDictModule, GraspNetwork]:
    """The encoder of a GraspActor, GraspCritic or GoalPredictor, and the network without it.

    One after the other they compute what the network does, with its own parameters: what trains the rest
    trains the network. The rest reads `feature_key` in place of what the encoder reads; time left and what
    else joins the feature it reads as before.

    Args:
        network: whose encoder is taken out; it stays as it is.
        feature_key: where the encoder writes the feature (*, F), and the rest reads it.

    Returns:
        The encoder, from a cloud or image (and the table's plane, where heights are a channel of the
        cloud) to `feature_key`; and the rest.

    Raises:
        ConfigError: where the action is joined to what the encoder reads (``fusion="early"``): such a
            feature is not the state's; and for networks that are not built on an encoder of ours.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchgrasp.modules import GraspActor, PointNet
        >>> actor = GraspActor(PointNet, freeze_encoder=True)
        >>> encoder, rest = split_network(actor, "feature")
        >>> td = TensorDict({"points": torch.rand(2, 64, 4), "time_left": torch.ones(2, 1)}, [2])
        >>> torch.equal(rest(encoder(td.clone()))["action"], actor(td)["action"])
        True
        >>> rest.in_keys
        ['feature', 'time_left']
    """
    whole: Any = getattr(network, "module", None)
    if not isinstance(whole, EncoderNetwork):
        raise ConfigError(
            f"network {type(network).__name__} has no encoder of its own to take out: give a GraspActor, "
            "GraspCritic or GoalPredictor."
        )
    if whole.reads_action_early:
        raise ConfigError(
            f"network {type(network).__name__} joins the action to what its encoder reads, so that no "
            "feature is the state's alone: build it with fusion='late', or leave its encoder in."
        )
    observed, *beside = map(unravel_key, network.in_keys)
    look = _Look(whole.encoder, freeze=whole.encoder_is_frozen)
    look.joins_heights = whole.joins_heights
    # The plane stands last, before the action of a critic.
    plane = [beside[-2 if whole.reads_action else -1]] if whole.joins_heights else []
    rest = copy(whole)
    rest.joins_heights = rest.encoder_is_frozen = False
    rest._modules = {**whole._modules, "encoder": GivenFeature(_size(whole.encoder))}
    return (
        TensorDictModule(look, in_keys=[observed, *plane], out_keys=[feature_key]),
        GraspNetwork(rest, in_keys=[feature_key, *beside], out_keys=network.out_keys),
    )


def _size(encoder: Any) -> int:
    return encoder.out_features
