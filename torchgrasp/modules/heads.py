"""What actor, critic and goal predictor share: encoders to order, action bounds, heads (Sec. 6.3)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import GOAL_SIZE
from torchgrasp.modules.batch_parts import encode_in_parts
from torchgrasp.modules.layers import Norm, mlp, shrink_last_layer

# Heights are divided by it, as PointNet divides coordinates: about the size of an object, metres.
_HEIGHT_SCALE = 0.1
# Numbers of a plane: unit normal and distance.
PLANE_SIZE = 4

# Further observations that join the feature, and the numbers in each.
StateInputs = Mapping[NestedKey, int]

# An encoder, or what makes one for a number of input channels (in YAML: `_partial_: true`).
Encoder = nn.Module | Callable[[int], nn.Module]


class EncoderNetwork(nn.Module):
    """A network on an encoder, which it holds as it is where `freeze` says so.

    A frozen encoder's parameters get no gradients, `train` leaves it in evaluation mode, and gradients
    still pass through it to its input.

    Attributes:
        reads_action: whether the action is the last of its inputs.
        reads_action_early: whether the encoder sees it.
    """

    reads_action = False
    reads_action_early = False

    def __init__(self, encoder: nn.Module, *, freeze: bool = False, reads_table: bool = False) -> None:
        super().__init__()
        self.encoder, self.encoder_is_frozen = encoder, freeze
        self.joins_heights = reads_table and sees_clouds(encoder)
        if freeze:
            encoder.requires_grad_(False).eval()

    def train(self, mode: bool = True) -> EncoderNetwork:
        """Set the mode of all but a frozen encoder."""
        super().train(mode)
        if self.encoder_is_frozen:
            self.encoder.eval()
        return self

    def encode(self, observed: Tensor, *vectors: Tensor, dtype: torch.dtype) -> Tensor:
        """The feature (*, F) of what is observed with vectors (*, D) beside it, the table's plane last.

        `dtype` is that of the network's weights, which is asked of one of them: in a loss, `parameters`
        finds none.
        """
        plane = vectors[-1:] if self.joins_heights else ()
        feature = self.look(observed, *plane, dtype=dtype)
        return torch.cat((feature, *(vector.to(feature.dtype) for vector in vectors)), dim=-1)

    def look(self, observed: Tensor, *plane: Tensor, dtype: torch.dtype) -> Tensor:
        """The encoder's feature alone, of what is observed and, where heights join it, the plane (*, 4)."""
        if observed.is_floating_point():
            observed = observed.to(dtype)
        if self.joins_heights:
            observed = join_heights(observed, plane[0].to(observed.dtype))
        return encode_in_parts(self.encoder, observed)


def build_encoder(
    encoder: Encoder, in_channels: int, *, freeze: bool = False, heights: bool = False
) -> tuple[nn.Module, int]:
    """The encoder for inputs of `in_channels`, and the size of its feature, its `out_features`.

    A module is taken as it is, or copied to `freeze` it: its other owners go on training theirs. With
    `heights`, points have one more channel; images have none.
    """
    if isinstance(encoder, nn.Module):
        built = deepcopy(encoder) if freeze else encoder
    else:
        built = encoder(in_channels + heights)
        if heights and not sees_clouds(built):
            built = encoder(in_channels)
    size = getattr(built, "out_features", None)
    if not isinstance(size, int):
        raise ConfigError(
            f"encoder {type(built).__name__} has no integer attribute `out_features`: "
            "set it to the size of the feature that the encoder returns."
        )
    return built, size


def sees_clouds(encoder: nn.Module) -> bool:
    """Whether the encoder takes clouds rather than images."""
    return get_channel_dim(encoder) == -1


def get_channel_dim(encoder: nn.Module) -> int | None:
    """Where the encoder's inputs have their channels: its `channel_dim`, -1 without one, as of clouds.

    None where they have none: features.
    """
    dim = getattr(encoder, "channel_dim", -1)
    return None if dim is None else int(dim)


def join_channels(inputs: Tensor, vector: Tensor, dim: int) -> Tensor:
    """Early fusion: `vector` (*, A) as A further channels, equal at every point or pixel of `inputs`.

    Args:
        inputs: (*, N, C) clouds or (*, C, H, W) images.
        vector: (*, A).
        dim: where `inputs` have their channels, counted from the end.
    """
    if not inputs.is_floating_point():
        raise ConfigError(
            f"inputs of type {inputs.dtype} cannot take the action beside them: give floating point, "
            "colours in [0, 1] (CameraImage makes them of bytes)."
        )
    size = vector.shape[-1]
    inner = [1] * (inputs.ndim - vector.ndim + 1)
    inner[dim] = size
    shape = list(inputs.shape)
    shape[dim] = size
    joined = vector.to(inputs.dtype).reshape(*vector.shape[:-1], *inner).expand(shape)
    return torch.cat((inputs, joined), dim=dim)


def join_heights(cloud: Tensor, plane: Tensor) -> Tensor:
    """(*, N, C) clouds, xyz first, with one more channel: heights above `plane` (*, 4), in units of 10 cm."""
    normal, distance = plane[..., None, :3], plane[..., None, 3:]
    heights = (cloud[..., :3] * normal).sum(dim=-1, keepdim=True) + distance
    return torch.cat((cloud, heights / _HEIGHT_SCALE), dim=-1)


def check_keys(name: str, given: Sequence[NestedKey], meaning: Sequence[str]) -> list[NestedKey]:
    """The keys `given` as a list; ConfigError unless there is one for each of `meaning`."""
    if len(given) != len(meaning):
        raise ConfigError(f"{name}={list(given)} must name {len(meaning)}: {', '.join(meaning)}.")
    return [as_key(key) for key in given]


def as_key(given: NestedKey) -> NestedKey:
    """A key as tensordict takes it: a nested one may be any sequence, as YAML has no tuples."""
    return given if isinstance(given, str) else tuple(given)


def check_inputs(state_inputs: StateInputs | None) -> dict[NestedKey, int]:
    """The further observations that join the feature, none for None; ConfigError where a size is none."""
    if not isinstance(state_inputs, Mapping | None):
        raise ConfigError(f"state_inputs={state_inputs}: give {{key: size}}, such as {{wrist_angle: 1}}.")
    inputs = dict(state_inputs or {})
    for key, size in inputs.items():
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise ConfigError(f"state_inputs[{key!r}]={size}: give the size of that observation, 1 or more.")
    return inputs


def choose_out_keys(given: Sequence[NestedKey], first: str, *, predicts_goal: bool) -> list[NestedKey]:
    """The keys written: that of `first` and, where it is predicted, that of the goal."""
    if len(given) not in ((2,) if predicts_goal else (1, 2)):
        raise ConfigError(
            f"out_keys={list(given)} must name {first}, then the goal prediction; for {first} alone give "
            "goal_prediction=False."
        )
    return [as_key(key) for key in given][: 1 + predicts_goal]


def bound_tensor(action_bound: Sequence[float]) -> Tensor:
    """The largest magnitude of each action component as a (A,) float32 tensor, checked."""
    numbers = tuple(action_bound) if isinstance(action_bound, Iterable) else ()
    bound = torch.as_tensor(numbers, dtype=torch.float32, device="cpu")  # a network may be made on `meta`
    if bound.ndim != 1 or len(bound) == 0 or not ((bound > 0) & bound.isfinite()).all():
        raise ConfigError(
            f"action_bound={action_bound} must be a sequence of positive, finite numbers, one a component, "
            "such as [2.0] of one."
        )
    return torch.as_tensor(numbers, dtype=torch.float32)


def head(in_features: int, hidden: int, out_features: int, *, norm: Norm = "none") -> nn.Sequential:
    """Three fully connected layers with ReLU between them (Sec. 6.3), and `norm` before each ReLU."""
    return mlp((in_features, hidden, hidden, out_features), norm=norm)


class GoalHead(nn.Module):
    """(*, F) features to the (*, 7) final grasp in the ee frame: metres, then a unit quaternion xyzw.

    The sign of the quaternion is free: q and -q are one rotation. At the start, every prediction is
    close to the ee's own pose.
    """

    def __init__(self, in_features: int, hidden: int) -> None:
        super().__init__()
        self.layers = head(in_features, hidden, GOAL_SIZE)
        shrink_last_layer(self.layers, 0.1)
        last = self.layers[-1]
        assert isinstance(last, nn.Linear)
        last.bias.data[-1] = 1.0

    @property
    def dtype(self) -> torch.dtype:
        """The type of its weights."""
        first = self.layers[0]
        assert isinstance(first, nn.Linear)
        return first.weight.dtype

    def forward(self, feature: Tensor) -> Tensor:
        """(*, F) features to (*, 7) goals."""
        goal = self.layers(feature)
        quaternion = nn.functional.normalize(goal[..., 3:], dim=-1, eps=1e-6)
        return torch.cat((goal[..., :3], quaternion), dim=-1)
