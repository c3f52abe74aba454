"""MirroredPolicy: what a policy does in the mean over the hand's reflections."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import unravel_key
from torch import Tensor

from torchgrasp import keys
from torchgrasp.errors import ConfigError


class Mirror(Protocol):
    """Reflects states and actions, as `torchgrasp.transforms.RandomMirror` does."""

    def reflect(self, tensordict: TensorDictBase, signs: Tensor) -> TensorDictBase:
        """Reflect what it knows of a tensordict (*) by signs (*, 2) of x and y, in place, and return it."""
        ...

    @property
    def reflected(self) -> list[NestedKey]:
        """The keys that it knows."""
        ...


class MirroredPolicy(TensorDictModuleBase):
    """Acts by the mean of a policy's actions on all four reflections of a state, each reflected back.

    The hand looks the same in the mirror of its x and y. A policy that learned from reflected states should
    act the same there, and does so nearly; the mean does exactly, and may err less:

        action(s) = 1/4 sum_g g^-1 policy(g s)

    This makes a network equivariant without training it (Basu et al. 2023, "Equi-Tuning", arXiv 2210.06475).
    It costs four times the network, in one batch. What the policy writes besides the action, such as a goal
    prediction, is that of the state as it is: the mean of several grasps is no grasp.

    Args:
        policy: reads and writes the keys that `mirror` knows; its other inputs are `unchanged`.
        mirror: how states and actions are reflected.
        unchanged: inputs that are the same in every reflection.
        action_key: of the action.

    Raises:
        ConfigError: where the policy reads what the mirror does not know, such as images, or where the
            policy does not write the action or the mirror does not know it.

    Example:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> from torchgrasp.transforms import RandomMirror
        >>> squint = TensorDictModule(
        ...     lambda points: torch.nn.functional.pad(points.mean(-2) + 0.1, (0, 3)), ["points"], ["action"]
        ... )
        >>> ahead = TensorDict({"points": torch.tensor([[[0.0, 0.0, 0.5]]])}, [1])
        >>> MirroredPolicy(squint, RandomMirror())(ahead)["action"].tolist()
        [[0.0, 0.0, 0.6000000238418579, 0.0, 0.0, 0.0]]
    """

    signs: Tensor

    def __init__(
        self,
        policy: TensorDictModuleBase,
        mirror: Mirror,
        *,
        unchanged: Sequence[NestedKey] = (keys.TIME_LEFT,),
        action_key: NestedKey = keys.ACTION,
    ) -> None:
        super().__init__()
        known = {unravel_key(key) for key in (*mirror.reflected, *unchanged)}
        unknown = [key for key in policy.in_keys if unravel_key(key) not in known]
        if unknown:
            raise ConfigError(
                f"The policy reads {unknown[0]!r}, whose reflection is not known, so that it cannot be "
                "mirrored: let it act as it is."
            )
        for name, there in (("policy writes", policy.out_keys), ("mirror knows", mirror.reflected)):
            if unravel_key(action_key) not in {unravel_key(key) for key in there}:
                raise ConfigError(f"The {name} no {action_key!r}: name the action by action_key.")
        self.policy, self.mirror, self.action_key = policy, mirror, action_key
        self.in_keys, self.out_keys = list(policy.in_keys), list(policy.out_keys)  # pyright: ignore
        signs = torch.tensor([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
        self.register_buffer("signs", signs, persistent=False)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the mean action, and what else the policy writes."""
        shape = tensordict.batch_size
        signs = self.signs.reshape(4, *[1] * len(shape), 2).expand(4, *shape, 2)
        views = tensordict.select(*self.in_keys).expand(4, *shape)
        written = self.policy(self.mirror.reflect(views, signs))
        for key in self.out_keys:
            tensordict.set(key, written.get(key)[0])
        actions = self.mirror.reflect(written.select(self.action_key), signs)
        return tensordict.set(self.action_key, actions.get(self.action_key).mean(dim=0))
