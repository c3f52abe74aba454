"""The replay buffer of a run: its demonstrations, and the episodes of its own that are added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hydra.utils import instantiate
from networks import check_state_inputs, make_codec, make_row
from omegaconf import DictConfig
from origin import check_rows
from sources import Source, count_steps, list_demonstrations, share_batch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp.data import MixtureReplayBuffer, Priority, estimate_bytes, open_demonstrations
from torchgrasp.data.buffer_memory import check_space, count_row_bytes
from torchgrasp.data.demonstration_kinds import COUNTED
from torchgrasp.errors import ConfigError
from torchgrasp.rollouts.episode_pool import Episode

_TOLD = ("kind", "episodes", "successes", "steps", "successful_steps", "bytes")


class Experience:
    """What a run learns from; refuses at once what would not fit the memory once it is collected.

    Args:
        cfg: the recipe's configuration.
        networks: by name; what they read is stored.
        shapes: of the observations, as `common.observed_shapes` tells them.
        own: name of the source that episodes are added to.
    """

    def __init__(
        self,
        cfg: DictConfig,
        networks: Mapping[str, TensorDictModuleBase],
        shapes: Mapping[Any, tuple[int, ...]],
        *,
        own: str = "online",
    ) -> None:
        self._cfg, self.own = cfg, own
        self.codec = make_codec(cfg, networks)
        self._augment = instantiate(cfg.replay.augment)
        self.row = make_row(self.codec, self._augment, shapes)
        check_state_inputs(cfg.model, shapes)
        self.priority: Priority | None = instantiate(cfg.replay.priority)
        # Offline nothing is added, and a source has room for at least one row.
        self._own_rows = 1 if cfg.offline.updates else int(cfg.replay.online_capacity)
        row_bytes = count_row_bytes(self.row, prioritised=self.priority is not None)
        asked = count_steps(list_demonstrations(cfg).values())
        check_space(self._own_rows + asked, row_bytes, folder=cfg.replay.folder)  # before hours of collecting
        self.buffer: MixtureReplayBuffer

    def make_buffer(self, sources: Sequence[Source]) -> None:
        """An empty buffer with room for the demonstrations of the sources."""
        cfg, prioritised = self._cfg, self.priority is not None
        self._sources, self._opened = list(sources), {}
        for source in sources:
            self._opened[source.name] = open_demonstrations(source.path)
            check_rows(self._opened[source.name], self.row)
        rows = {name: opened.card["rows"] for name, opened in self._opened.items()}
        capacities = {self.own: self._own_rows, **rows}
        size = estimate_bytes(sum(capacities.values()), self.row, prioritised=prioritised)
        print(f"Replay buffer: up to {size / 1e9:.2f} GB for {capacities} transitions")
        self.buffer = MixtureReplayBuffer(
            capacities,
            share_batch(self.own, cfg.replay.online_fraction, self._weigh()),
            batch_size=cfg.replay.batch_size,
            seed=cfg.seed,
            folder=cfg.replay.folder,
            row=self.row,
            priority=self.priority,
            codec=self.codec,
            transform=self._augment,
        )

    def _weigh(self, *, labelled: bool = False) -> dict[str, float]:
        """Weight of each source of demonstrations, 0 without labels where those are wanted."""
        weights = {}
        for each in self._sources:
            steps = self._opened[each.name].card[COUNTED[each.count]]
            weight = steps if each.weight is None else each.weight
            weights[each.name] = float(weight) if each.labels or not labelled else 0.0
        if not sum(weights.values()):
            raise ConfigError(
                "No demonstrations are left to learn from: give one of them demonstrations.labels=true and a "
                "demonstrations.weight above 0."
            )
        return weights

    def load_demonstrations(self) -> None:
        """Fill each source with the steps of its demonstrations that count."""
        for source in self._sources:
            for rows in self._opened[source.name].iterate_rows():
                self.buffer.extend_rows(source.choose(rows), source=source.name)

    def add(self, episode: Episode) -> None:
        """Add an episode of this run."""
        self.buffer.extend(episode.steps[None], source=self.own)

    def draw_demonstrations(self) -> None:
        """From the next batch on, draw from demonstrations with labels alone."""
        self.buffer.set_shares(share_batch(self.own, 0.0, self._weigh(labelled=True)))

    def draw_all(self, *, labelled: bool = False) -> None:
        """From the next batch on, draw as configured, on demand from demonstrations with labels alone."""
        fraction = 0.0 if self._cfg.offline.updates else self._cfg.replay.online_fraction
        self.buffer.set_shares(share_batch(self.own, fraction, self._weigh(labelled=labelled)))

    def sample(self, batch_size: int | None = None) -> TensorDictBase:
        """A batch (B) on the device of the networks."""
        return self.buffer.sample(batch_size).to(self._cfg.device)

    def describe(self) -> dict:
        """Kind, episodes, successes, steps and bytes of the demonstrations, and of further ones by name."""
        cards = {name: {key: each.card[key] for key in _TOLD} for name, each in self._opened.items()}
        first, *others = cards
        more = {"more_demonstrations": {name: cards[name] for name in others}} if others else {}
        return {"demonstrations": cards[first], **more}
