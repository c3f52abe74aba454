"""Folders of demonstrations as sources of the replay buffer: which of their rows teach, and what."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.data.demonstration_kinds import find_counted
from torchgrasp.data.demonstrations import Demonstrations
from torchgrasp.errors import ConfigError


@dataclass(frozen=True)
class DemonstrationSource:
    """A folder of demonstrations that batches are drawn from.

    Attributes:
        name: of the source in the replay buffer.
        path: the folder.
        count: which of its episodes are drawn from: all, successful or failed.
        labels: whether its actions and goals are imitated.
        weight: in a batch, relative to other demonstrations; None for as many as it has steps.

    >>> from tensordict import TensorDict
    >>> flags = {key: torch.ones(2, 1, dtype=torch.bool) for key in ("has_expert", "has_goal")}
    >>> rows = TensorDict({**flags, "episode_success": torch.tensor([[True], [False]])}, [2])
    >>> failed = DemonstrationSource("failed", Path("demos/failed"), "failed", labels=False)
    >>> failed.choose(rows)["has_expert"]
    tensor([[False]])
    """

    name: str
    path: Path
    count: str
    labels: bool = True
    weight: float | None = None

    def choose(self, rows: TensorDictBase) -> TensorDictBase:
        """Those of the encoded `rows` (R) that count, as this source teaches them."""
        chosen = rows[find_counted(rows, self.count)]
        return chosen if self.labels else _clear(chosen, keys.HAS_EXPERT, keys.HAS_GOAL)


def without_expert(steps: TensorDictBase) -> TensorDictBase:
    """The same steps (*), of whose states no expert has told what to do."""
    return _clear(steps, keys.HAS_EXPERT)


def _clear(steps: TensorDictBase, *flags: str) -> TensorDictBase:
    there = {flag: steps.get(flag, None) for flag in flags}
    return steps.update({flag: torch.zeros_like(each) for flag, each in there.items() if each is not None})


def check_rows(demonstrations: Demonstrations, row: TensorDictBase) -> None:
    """Refuse demonstrations whose rows have not the shapes of the encoded `row` (1) to be stored."""
    # Which source they are is told when they are added.
    expected = {name: tuple(value.shape[1:]) for name, value in row.items() if name != keys.SOURCE}
    for rows in demonstrations.iterate_rows():
        for name, shape in expected.items():
            value = rows.get(name, None)
            found = None if value is None else tuple(value.shape[1:])
            if found != shape:
                raise ConfigError(
                    f"The demonstrations in {demonstrations.path} hold {name!r} of shape {found}, {shape} is "
                    "wanted: take the transforms and networks that they were made for, or others."
                )
