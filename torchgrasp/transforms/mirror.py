"""RandomMirror: the hand's two symmetries, for four times the data or the mean of four actions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from torchgrasp import keys
from torchgrasp.errors import ConfigError


class RandomMirror(Transform):
    """Reflects sampled transitions in the hand's x, y, both or neither, each drawn with a half.

    The hand looks the same in the mirror of either plane, so a reflected cloud with reflected labels is
    a state and label as good as the first, but for the wrist camera, 3.6 cm off the axis, and for what
    the arm can reach. Use it in a replay buffer; state and next state get the same reflection.

    Args:
        point_keys: clouds (*, N, C), xyz first.
        action_keys: relative poses (*, 6), translation and intrinsic XYZ Euler angles.
        goal_keys: poses (*, 7), translation and quaternion xyzw.
        plane_keys: planes (*, 4), normal and distance.
        turn_keys: angles (*, 1) about the hand's z.
        feature_keys: features (*, 4, ...) of all four reflections, in the order of `views`, as KeepFeatures
            keeps them: that of the reflection drawn is taken, (*, ...).
        generator: of the draws; torch's own without one.

    Example:
        >>> from tensordict import TensorDict
        >>> td = RandomMirror()(TensorDict({"points": torch.ones(64, 5, 3)}, [64]))
        >>> sorted(td["points"][:, 0, 0].unique().tolist())
        [-1.0, 1.0]
    """

    def __init__(
        self,
        *,
        point_keys: Sequence[NestedKey] = (keys.POINTS, ("next", keys.POINTS)),
        action_keys: Sequence[NestedKey] = (keys.ACTION, keys.EXPERT_ACTION),
        goal_keys: Sequence[NestedKey] = (keys.GOAL, ("next", keys.GOAL)),
        plane_keys: Sequence[NestedKey] = (keys.TABLE_PLANE, ("next", keys.TABLE_PLANE)),
        turn_keys: Sequence[NestedKey] = (keys.WRIST_ANGLE, ("next", keys.WRIST_ANGLE)),
        feature_keys: Sequence[NestedKey] = (),
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        self._points, self._actions, self._goals = tuple(point_keys), tuple(action_keys), tuple(goal_keys)
        self._planes, self._turns = tuple(plane_keys), tuple(turn_keys)
        self.feature_keys, self._generator = tuple(feature_keys), generator

    @property
    def reflected(self) -> list[NestedKey]:
        """The keys of all that is reflected where it is there."""
        return [*self._points, *self._actions, *self._goals, *self._planes, *self._turns]

    @property
    def views(self) -> list[Callable[[TensorDictBase], TensorDictBase]]:
        """Functions of a tensordict (*), one for each reflection: in x and y, in x, in y, in none."""
        return [partial(self._reflect_all, number=number) for number in range(4)]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reflect every element of the batch by a draw of its own."""
        known = (*self._points, *self.feature_keys)
        if all(tensordict.get(key, None) is None for key in known):
            raise ConfigError(
                f"RandomMirror finds none of {list(self._points)}, and labels without the cloud that they "
                "belong to must not be mirrored: name the clouds by point_keys, or leave "
                "RandomMirror out, as for policies that see images."
            )
        draws = torch.randint(0, 2, (*tensordict.batch_size, 2), generator=self._generator)
        self._pick(tensordict, draws)
        return self.reflect(tensordict, 2.0 * draws - 1.0)

    def _reflect_all(self, tensordict: TensorDictBase, *, number: int) -> TensorDictBase:
        signs = 2.0 * torch.tensor((number // 2, number % 2)) - 1.0
        return self.reflect(tensordict, signs.expand(*tensordict.batch_size, 2))

    def _pick(self, tensordict: TensorDictBase, draws: Tensor) -> None:
        """Leave of kept features those of the reflections (*, 2) drawn."""
        number = (2 * draws[..., 0] + draws[..., 1]).to(tensordict.device).reshape(-1)
        for key in self.feature_keys:
            features = tensordict.get(key, None)
            if features is not None:
                rows = features.reshape(-1, *features.shape[tensordict.ndim :])
                picked = rows[torch.arange(len(rows), device=rows.device), number]
                tensordict.set(key, picked.reshape(*tensordict.batch_size, *picked.shape[1:]))

    def reflect(self, tensordict: TensorDictBase, signs: Tensor) -> TensorDictBase:
        """Reflect each element of a tensordict (*) by its signs (*, 2), in place: -1 in x, -1 in y."""
        sx, sy = signs.to(tensordict.device, non_blocking=True).unbind(-1)
        one = torch.ones_like(sx)
        # S R S for S = diag(sx, sy, 1): a turn about an axis keeps its sense or loses it.
        position, turn = (sx, sy, one), (sy, sx, sx * sy)
        self._scale(tensordict, self._points, torch.stack(position, dim=-1))
        self._scale(tensordict, self._planes, torch.stack(position, dim=-1))
        self._scale(tensordict, self._turns, (sx * sy)[..., None])
        self._scale(tensordict, self._actions, torch.stack((*position, *turn), dim=-1))
        self._scale(tensordict, self._goals, torch.stack((*position, *turn, one), dim=-1))
        return tensordict

    def _scale(self, tensordict: TensorDictBase, names: Sequence[NestedKey], signs: Tensor) -> None:
        size = signs.shape[-1]
        for key in names:
            value = tensordict.get(key, None)
            if value is not None:
                further = [1] * (value.ndim - signs.ndim)  # of a cloud its points
                factors = signs.reshape(*signs.shape[:-1], *further, size)
                signed = torch.cat((value[..., :size] * factors, value[..., size:]), dim=-1)
                tensordict.set(key, signed)
