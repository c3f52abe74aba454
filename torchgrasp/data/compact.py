"""CompactTransitions: trajectories to rows of some 6 kB, and sampled rows back to transitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from torchgrasp import keys
from torchgrasp.data.encodings import (
    CloudEncoding,
    Encoding,
    FeatureEncoding,
    FeatureType,
    ImageEncoding,
    PlainEncoding,
)
from torchgrasp.data.sampler import STUB
from torchgrasp.episodes import check_trajectories, find_links, label_episode_success
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_SIZE, NO_GOAL, gripper_control_points

_FLAGS = (keys.HAS_EXPERT, keys.HAS_GOAL, keys.PERTURBED)
_OUTCOMES = ("reward", "terminated", "done")
# Labels that are told anew in each next state.
_GOAL_LABELS = (keys.GOAL, keys.HAS_GOAL)


class CompactTransitions(Transform):
    """Buffer transform: stores each state once, clouds and pictures compactly, and rebuilds transitions.

    `inv` (on extend) takes a tensordict (*, T) from a collector or `rollout`, time last, and gives
    rows in order of time. A state whose successor is not the next row (the rollout was cut there,
    or the episode was truncated) is followed by a stub: a row that holds the last observation and
    is never drawn. `forward` (on sample) takes rows whose next observations the storage has read
    from the following row (`MixtureStorage(next_keys=codec.observation_keys)`). On rows that
    terminated, next observations are those of the row itself: values there are masked.

    The gripper's six points end the cloud, equal in every state (X_g of Eq. (2)), and flags follow
    from the place, so that neither is stored. Labels that the data lack are stored as absent.

    Args:
        points_key: the cloud, (*, T, N + 6, 4) in metres, ee frame; flag last. None where there is none.
        gripper_points: False for clouds without gripper points and flags: all of (*, T, N, C) is stored.
        image_key: the picture that `image_channels` describes.
        image_channels: keeps pictures (*, T, C, H, W) as `ImageEncoding` does: their planes by letters,
            as CameraImage names them. None where there are none.
        state_keys: further observations, with next values, as they are; of labels such as the goal too.
        extra_keys: further keys to keep as they are, without next values; what is stored anyway may be named.
        features: a transform, `KeepFeatures`, whose out_keys are stored with their next values: it is called
            once a state, on what is stored of it, and not at all on rows that have them.
        feature_dtype: float16, bfloat16 or float32; see `FeatureEncoding` for what each costs.
        drop_keys: observations that `features` reads and nothing else does: they are not stored.

    >>> from tensordict import TensorDict
    >>> codec = CompactTransitions(points_key=None, image_channels="d", state_keys=())
    >>> state, ends = {"image": torch.rand(3, 1, 8, 8)}, {"done": torch.tensor([[False], [False], [True]])}
    >>> ends |= {"terminated": ends["done"], "reward": torch.zeros(3, 1)}
    >>> rows = codec.inv(TensorDict({**state, "action": torch.zeros(3, 6), "next": {**state, **ends}}, [3]))
    >>> rows["image"].shape, codec(rows)["image"].shape
    (torch.Size([3, 2, 8, 8]), torch.Size([3, 1, 8, 8]))
    """

    def __init__(
        self,
        *,
        points_key: NestedKey | None = keys.POINTS,
        gripper_points: bool = True,
        image_key: NestedKey = keys.IMAGE,
        image_channels: str | None = None,
        state_keys: Sequence[NestedKey] = (keys.TIME_LEFT,),
        extra_keys: Sequence[NestedKey] = (),
        features: Transform | None = None,
        feature_dtype: FeatureType = "float16",
        drop_keys: Sequence[NestedKey] = (),
    ) -> None:
        super().__init__()
        self.points_key, self.gripper_points = points_key, gripper_points
        self._given: dict[NestedKey, Encoding] = {}  # of what trajectories have
        if points_key is not None:
            self._given[points_key] = CloudEncoding(points_key, gripper_points=gripper_points)
        if image_channels is not None:
            self._given[image_key] = ImageEncoding(image_key, image_channels)
        self._given |= {_as_key(key): PlainEncoding() for key in state_keys}
        if not self._given:
            raise ConfigError("CompactTransitions stores no observation: give points_key or image_channels.")
        self.features = features
        made = [] if features is None else [_as_key(key) for key in features.out_keys]
        self._made = {key: FeatureEncoding(key, feature_dtype) for key in made}
        self._dropped = tuple(map(_as_key, drop_keys))
        self._check_features()
        kept = {key: encoding for key, encoding in self._given.items() if key not in self._dropped}
        self._encodings: dict[NestedKey, Encoding] = {**kept, **self._made}  # of what rows have
        stored = {*self._given, *self._made, keys.ACTION, *default_labels(), *_OUTCOMES}
        stored |= {keys.EPISODE_SUCCESS, keys.SOURCE}
        self._extra_keys = tuple(key for key in map(_as_key, extra_keys) if key not in stored)

    def _check_features(self) -> None:
        read = [] if self.features is None else [_as_key(key) for key in self.features.in_keys]
        if absent := [key for key in (*read, *self._dropped) if key not in self._given]:
            raise ConfigError(
                f"features and drop_keys name {absent}, which is no observation of this codec: add it to "
                "state_keys, or give points_key or image_channels."
            )
        if wrong := [key for key in self._dropped if key not in read]:
            raise ConfigError(f"drop_keys={wrong}: drop what `features` reads, and nothing else.")

    @property
    def observation_keys(self) -> tuple[NestedKey, ...]:
        """The observations, which have next values; the storage reads those from the following row."""
        return tuple(self._encodings)

    @property
    def given_keys(self) -> tuple[NestedKey, ...]:
        """The observations that trajectories bring along; `features` makes the others."""
        return tuple(self._given)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.encode(tensordict)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Rows (*) with ("next", observations) to transitions (*)."""
        return self.decode(tensordict)

    def encode(self, trajectories: TensorDictBase) -> TensorDictBase:
        """Trajectories (*, T) to rows (R), each trajectory in order of time, stubs included."""
        return self.complete(self._encode_given(trajectories))

    def complete(self, rows: TensorDictBase) -> TensorDictBase:
        """Rows (R) that a codec without `features` has encoded, such as a file's, with the features made."""
        return self._complete(rows, self.features)

    def _complete(self, rows: TensorDictBase, features: Transform | None) -> TensorDictBase:
        if features is None or not any(rows.get(key, None) is None for key in self._made):
            return rows
        state = {key: self._given[key].decode(_read(rows, key)) for key in map(_as_key, features.in_keys)}
        made = features(TensorDict(state, rows.shape))
        rows = rows.exclude(*self._dropped)
        for key, encoding in self._made.items():
            rows[key] = encoding.encode(made[key])
        return rows

    def _encode_given(self, trajectories: TensorDictBase) -> TensorDict:
        check_trajectories(trajectories)
        steps = trajectories.reshape(-1, trajectories.shape[-1])
        valid, linked = find_links(steps)
        terminated = steps["next", "terminated"].squeeze(-1)
        needs_stub = valid & ~terminated & ~linked
        flat = steps.reshape(-1)
        step, stub = _order_rows(valid.reshape(-1), needs_stub.reshape(-1))
        rows = TensorDict({}, step.shape)
        for key, value in self._labels(steps).items():
            rows[key] = value.reshape(steps.numel(), -1)[step]
        for key, encoding in self._given.items():
            rows[key] = encoding.encode(_read(flat, key)[step])
            if bool(stub.any()):
                rows[key][stub] = encoding.encode(_read(flat["next"], key, after_cut=True)[step[stub]])
        # What a stub holds is told of the next state.
        for key in _GOAL_LABELS:
            told = flat.get(("next", key), None)
            if told is not None:
                rows[key][stub] = told.reshape(steps.numel(), -1)[step[stub]]
        for key in self._extra_keys:
            rows[key] = _read(flat, key)[step]
        return rows.set(STUB, stub.unsqueeze(-1))

    def _labels(self, steps: TensorDictBase) -> dict[NestedKey, Tensor]:
        shape = steps.shape
        labels: dict[NestedKey, Tensor] = {keys.ACTION: steps[keys.ACTION]}
        for key, default in default_labels().items():
            labels[key] = _get_or(steps, key, default.expand(*shape, *default.shape))
        for key in _OUTCOMES:
            labels[key] = steps["next", key]
        if steps.get(keys.EPISODE_SUCCESS, None) is None:
            steps = label_episode_success(steps.copy())
        labels[keys.EPISODE_SUCCESS] = steps[keys.EPISODE_SUCCESS]
        labels[keys.SOURCE] = _get_or(steps, keys.SOURCE, torch.zeros(*shape, 1, dtype=torch.int64))
        return labels

    def example_row(
        self,
        shapes: Mapping[NestedKey, Sequence[int]],
        *,
        dtypes: Mapping[NestedKey, torch.dtype] | None = None,
    ) -> TensorDictBase:
        """A row (1) of zeros, by which to tell what rows of such observations take.

        Args:
            shapes: of each observation and each of `extra_keys`, as an environment of one world gives it.
            dtypes: of those that are not float32.
        """
        kept, dtypes = (*self._given, *self._extra_keys), dtypes or {}
        if absent := [key for key in kept if key not in shapes]:
            raise ConfigError(
                f"The shapes of {absent} are missing, which CompactTransitions stores: give them as well, or "
                "leave these out of state_keys and extra_keys."
            )
        zeros = {key: torch.zeros(1, *shapes[key], dtype=dtypes.get(key, torch.float32)) for key in kept}
        state = TensorDict(zeros, [1])
        if self.points_key is not None and self.gripper_points:
            tail = gripper_control_points()
            state[self.points_key][..., -len(tail) :, :3] = tail
        end = torch.ones(1, 1, dtype=torch.bool)
        ends = {"reward": torch.zeros(1, 1), "terminated": end, "done": end}
        action = torch.zeros(1, ACTION_SIZE)
        step = state.copy().update({keys.ACTION: action, "next": state.copy().update(ends)})
        # A trial: the encoder may be given its weights later.
        return self._complete(self._encode_given(step), copy(self.features))

    def decode(self, rows: TensorDictBase) -> TensorDictBase:
        """Rows (*), with ("next", observations) or without, to float32 observations and TorchRL's keys."""
        batch = rows.exclude(STUB, *_OUTCOMES)
        following = rows.get("next", TensorDict({}, rows.shape)).copy()
        for key, encoding in self._encodings.items():
            batch[key] = encoding.decode(rows[key])
            stored = following.get(key, None)
            if stored is not None:
                following[key] = encoding.decode(stored)
        for key in _OUTCOMES:
            following[key] = rows[key]
        return batch.set("next", following)


def default_labels() -> dict[NestedKey, Tensor]:
    """Each label of a row, of its shape and type, as it is stored where the data lack it."""
    labels: dict[NestedKey, Tensor] = {keys.EXPERT_ACTION: torch.zeros(ACTION_SIZE)}
    labels[keys.GOAL] = torch.tensor(NO_GOAL)
    return labels | {key: torch.zeros(1, dtype=torch.bool) for key in _FLAGS}


def _as_key(key: NestedKey) -> NestedKey:
    """A key that a configuration gave: lists of names stand for tuples."""
    return key if isinstance(key, str) else tuple(key)


def _read(steps: TensorDictBase, key: NestedKey, *, after_cut: bool = False) -> Tensor:
    value = steps.get(key, None)
    if value is None:
        place = f'("next", {key!r}), which the last state of a cut rollout is,' if after_cut else repr(key)
        raise ConfigError(
            f"CompactTransitions finds no {place} in the trajectories: write it, keep it when they are "
            "handed over, or leave it out of state_keys and extra_keys."
        )
    return value


def _get_or(steps: TensorDictBase, key: NestedKey, default: Tensor) -> Tensor:
    value = steps.get(key, None)
    return default.to(steps["next", "done"].device) if value is None else value


def _order_rows(valid: Tensor, needs_stub: Tensor) -> tuple[Tensor, Tensor]:
    """The step (R) that each row is made of, in order of time, and whether (R) the row is its stub."""
    step = torch.cat((valid.nonzero().squeeze(-1), needs_stub.nonzero().squeeze(-1)))
    stub = torch.arange(step.numel(), device=step.device) >= valid.sum()
    order = torch.argsort(2 * step + stub)
    return step[order], stub[order]
