"""A list of critics as one critic."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn

from torchgrasp.errors import ConfigError
from torchgrasp.objectives.grasp_loss import unique_keys


class SideBySide(TensorDictModuleBase):
    """Runs each critic and writes what they write side by side along the last dimension.

    The critics keep their weights, may differ in kind, and may share modules.

    Args:
        critics: at least one, with the same out_keys.
    """

    def __init__(self, critics: Sequence[TensorDictModuleBase]) -> None:
        super().__init__()
        if not critics or any(critic.out_keys != critics[0].out_keys for critic in critics):
            written = [list(critic.out_keys) for critic in critics]
            raise ConfigError(f"critics write {written}: give at least one, and all with the same out_keys.")
        self.critics: Sequence[TensorDictModuleBase] = nn.ModuleList(critics)  # pyright: ignore
        self.in_keys = unique_keys(*(critic.in_keys for critic in critics))  # pyright: ignore
        self.out_keys = list(critics[0].out_keys)  # pyright: ignore

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the critics' outputs, concatenated, into `tensordict`."""
        written = [critic(tensordict.select(*critic.in_keys)) for critic in self.critics]
        for key in self.out_keys:
            tensordict.set(key, torch.cat([w.get(key) for w in written], dim=-1))
        return tensordict
