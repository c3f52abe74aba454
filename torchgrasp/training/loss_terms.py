"""Loss terms over several updates: added up where they are, fetched from the device once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor


class MeanTerms:
    """Means of scalar terms over the updates since they were last fetched.

    Reading a number from a GPU waits for all that is queued there, so nothing is read before `fetch`.

    Example:
        >>> from tensordict import TensorDict
        >>> terms = MeanTerms()
        >>> for value in (1.0, 3.0):
        ...     terms.add("actor", TensorDict({"loss_bc": torch.tensor(value)}))
        >>> terms.fetch(), terms.fetch()
        ({'actor/loss_bc': 2.0}, {})
    """

    def __init__(self) -> None:
        self._sums: dict[str, Tensor] = {}
        self._counts: dict[str, int] = {}

    def add(self, network: str, terms: TensorDictBase) -> None:
        """Add one update's scalar terms () of a network, as ``<network>/<term>``."""
        for key, value in terms.items():
            name = f"{network}/{key}"
            value = value.detach().double()
            self._sums[name] = self._sums[name] + value if name in self._sums else value
            self._counts[name] = self._counts.get(name, 0) + 1

    def fetch(self) -> dict[str, float]:
        """The means by name, in the order in which they first came; they begin anew."""
        if not self._sums:
            return {}
        sums = torch.stack(list(self._sums.values())).tolist()
        means = {name: total / self._counts[name] for name, total in zip(self._sums, sums, strict=True)}
        self._sums, self._counts = {}, {}
        return means

    def state_dict(self) -> dict[str, Any]:
        """What was added and not fetched: a run that goes on logs what it would have logged."""
        return {"sums": dict(self._sums), "counts": dict(self._counts)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take up what `state_dict` gave."""
        sums, counts = dict(state["sums"]), dict(state["counts"])
        for name, value in sums.items():
            if not isinstance(value, Tensor) or value.shape or not isinstance(counts.get(name), int):
                raise ValueError(f"{name} is no sum of a loss term")
        if counts.keys() != sums.keys() or min(counts.values(), default=1) < 1:
            raise ValueError("sums and counts of other loss terms")
        self._sums, self._counts = sums, counts
