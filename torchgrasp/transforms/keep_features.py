"""KeepFeatures: what a frozen encoder makes of a state, computed once and kept (Sec. 6.3)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Any, cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import Transform

from torchgrasp.errors import CheckpointError, ConfigError, check_whole
from torchgrasp.transforms.base import find_container


class KeepFeatures(Transform):
    """Writes the features of a frozen encoder into each state and its "next", each state encoded once.

    As the `transform` of a replay buffer it encodes what is extended, and the buffer stores the features:
    sampled batches have them, and the encoder does not run again. A batch without them, and a bare
    tensordict, gets them when it is called. In an environment it encodes every observation. TorchRL's
    ModuleTransform encodes every batch that is sampled, and "next" not at all.

    Features belong to one encoder's weights. Their fingerprint is the transform's state, which TorchRL's
    buffers save with their own: a buffer that another encoder has filled is refused when it is loaded, and
    so are further features once the encoder has changed.

    Args:
        encoder: from `in_keys` to features of any shape at `out_keys`; none of its parameters may require
            gradients. It runs in evaluation mode, on its own device, and is no part of the state_dict.
        views: functions of a tensordict, such as `RandomMirror.views`, each of which gives another view of
            a state; features of all of them are kept, (*, V, ...), and who samples takes one of them.
            Without any, features are those of the state itself, (*, ...).
        chunk_size: states that are encoded at once.

    Raises:
        ConfigError: for an encoder that learns or has changed, and states without what it reads.
        CheckpointError: when a buffer is loaded whose features another encoder has made.

    Example:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> encoder = TensorDictModule(torch.nn.Linear(8, 3), ["pixels"], ["feature"]).requires_grad_(False)
        >>> buffer = TensorDictReplayBuffer(
        ...     storage=LazyTensorStorage(10), transform=KeepFeatures(encoder), batch_size=4
        ... )
        >>> state, after = {"pixels": torch.rand(6, 8)}, {"pixels": torch.rand(6, 8)}
        >>> _ = buffer.extend(TensorDict({**state, "next": after}, [6]))
        >>> buffer.sample()["next", "feature"].shape
        torch.Size([4, 3])
    """

    _encoder: TensorDictModuleBase

    def __init__(
        self,
        encoder: TensorDictModuleBase,
        *,
        views: Sequence[Callable[[TensorDictBase], TensorDictBase]] = (),
        chunk_size: int = 256,
    ) -> None:
        super().__init__(in_keys=list(encoder.in_keys), out_keys=list(encoder.out_keys))
        check_whole("chunk_size", chunk_size, 1)
        learning = [name for name, each in encoder.named_parameters() if each.requires_grad]
        if learning:
            raise ConfigError(
                f"encoder has parameters that learn, such as {learning[0]}, and kept features would soon be "
                "another's: freeze it by requires_grad_(False), or compute its features anew each time."
            )
        self._views, self._chunk_size = tuple(views), chunk_size
        # Not a submodule: its weights are saved by who owns it.
        self.__dict__["_encoder"] = encoder
        self._made_by: str | None = None
        self._seen_versions: int | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write what a tensordict (*) and its "next" lack; features that are there stay."""
        return self._write(tensordict, anew=False)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, anew=True)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if find_container(self) is not None:  # of an environment: these are actions
            return tensordict
        return self._write(tensordict.copy(), anew=True)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the features."""
        for key, value in self.encode(cast(TensorDictBase, observation_spec.zero())).items():
            observation_spec[key] = Unbounded(value.shape, dtype=value.dtype, device=observation_spec.device)
        return observation_spec

    def encode(self, states: TensorDictBase) -> dict[NestedKey, Tensor]:
        """The features (*, ...) or (*, V, ...) of states (*), by key; of equal states in a row once."""
        missing = [key for key in self.in_keys if states.get(key, None) is None]
        if missing:
            raise ConfigError(
                f"KeepFeatures needs {missing} of each state, which its encoder reads: keep them up to where "
                "features are made, or have the states bring their features along."
            )
        self._check_encoder()
        shape, rows = states.shape, states.select(*self.in_keys)
        rows = rows.reshape(-1) if shape else rows.unsqueeze(0)
        first = self._find_changes(rows)
        different = cast(TensorDictBase, rows[first])
        parts = [self._encode_rows(part) for part in different.split(self._chunk_size)]
        if not parts:
            parts = [self._encode_rows(rows)]
        index = first.cumsum(0) - 1
        return {
            key: torch.cat([part[key] for part in parts])[index].reshape(*shape, *parts[0][key].shape[1:])
            for key in self.out_keys
        }

    def _find_changes(self, rows: TensorDictBase) -> Tensor:
        """(B) bool: which rows (B) differ from the one before, as of actions tried in one state none does."""
        changed = torch.ones(len(rows), dtype=torch.bool, device=rows[self.in_keys[0]].device)
        if len(rows) > 1:
            same = [_equal_rows(rows[key][1:], rows[key][:-1]) for key in self.in_keys]
            changed[1:] = ~torch.stack(same).all(dim=0)
        return changed

    @torch.no_grad()
    def _encode_rows(self, rows: TensorDictBase) -> dict[NestedKey, Tensor]:
        home = rows[self.in_keys[0]].device
        weight = next(self._encoder.parameters(), None)
        inputs = rows if weight is None else rows.to(weight.device)
        seen = [self._encoder(view(inputs.copy())) for view in self._views]
        if not seen:
            written = self._encoder(inputs.copy())
            return {key: written[key].to(home) for key in self.out_keys}
        return {key: torch.stack([each[key] for each in seen], dim=1).to(home) for key in self.out_keys}

    def _write(self, states: TensorDictBase, *, anew: bool) -> TensorDictBase:
        following = self._find_next(states)
        if anew or self._lacks(states):
            features = self.encode(states)
            self._set(states, features)
            if following is not None:
                self._set(following, self._encode_next(states, following, features))
                states.set("next", following)
        elif following is not None and self._lacks(following):
            self._set(following, self.encode(following))
            states.set("next", following)
        return states

    def _find_next(self, states: TensorDictBase) -> TensorDictBase | None:
        """The next states, where there are some."""
        following = cast("TensorDictBase | None", states.get("next", None))
        if following is None or all(following.get(key, None) is None for key in self.in_keys):
            return None
        return following

    def _lacks(self, states: TensorDictBase) -> bool:
        return any(states.get(key, None) is None for key in self.out_keys)

    def _encode_next(
        self, states: TensorDictBase, following: TensorDictBase, features: dict[NestedKey, Tensor]
    ) -> dict[NestedKey, Tensor]:
        """Features of the next states (*); those that are the states of the next step have theirs already."""
        count = states.numel()
        here, after = (each.select(*self.in_keys).reshape(count) for each in (states, following))
        anew = torch.ones(count, dtype=torch.bool, device=here[self.in_keys[0]].device)
        if count > 1:
            same = [_equal_rows(after[key][:-1], here[key][1:]) for key in self.in_keys]
            anew[:-1] = ~torch.stack(same).all(dim=0)
        index = anew.nonzero().squeeze(-1)
        found = {
            key: value.reshape(count, *value.shape[states.ndim :]).roll(-1, 0)
            for key, value in features.items()
        }
        if len(index):
            for key, value in self.encode(after[index]).items():
                found[key] = found[key].index_copy(0, index, value)
        return {key: value.reshape(features[key].shape) for key, value in found.items()}

    @staticmethod
    def _set(states: TensorDictBase, features: dict[NestedKey, Tensor]) -> None:
        for key, value in features.items():
            states.set(key, value)

    def _check_encoder(self) -> None:
        """Note whose features are made; refuse to go on with those of another encoder."""
        self._encoder.eval()
        # Counted up by writes in place but those through `.data`: comparing weights each time would take
        # longer than a state does.
        versions = sum(each._version for each in self._tensors())
        if versions == self._seen_versions:
            return
        found = self._fingerprint()
        if self._made_by not in (None, found):
            raise ConfigError(
                "encoder has changed since features of it were kept: keep it as it is, or make a new "
                "KeepFeatures and fill the buffer anew."
            )
        self._made_by, self._seen_versions = found, versions

    def _tensors(self) -> list[Tensor]:
        return [*self._encoder.parameters(), *self._encoder.buffers()]

    def _fingerprint(self) -> str:
        """Of the encoder's weights, names and types included."""
        digest = hashlib.sha256()
        for name, value in sorted(self._encoder.state_dict().items()):
            if isinstance(value, Tensor):
                digest.update(f"{name} {value.dtype} {tuple(value.shape)};".encode())
                digest.update(
                    value.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes()
                )
        return digest.hexdigest()

    def get_extra_state(self) -> str:
        """Whose features were made: the fingerprint of the encoder, which `state_dict` holds."""
        return self._made_by or self._fingerprint()

    def set_extra_state(self, state: Any) -> None:
        """Refuse the features of another encoder."""
        found = self._fingerprint()
        if state != found:
            raise CheckpointError(
                "The features that were kept are of another encoder: load the weights of the one that made "
                "them first, or fill the buffer anew."
            )
        self._made_by, self._seen_versions = found, None


def _equal_rows(first: Tensor, second: Tensor) -> Tensor:
    """(B) bool: which rows of two (B, ...) tensors are equal."""
    return (first == second).reshape(len(first), -1).all(dim=-1)
