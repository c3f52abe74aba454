"""How far a training run has come, what it has brought, and its checkpoint."""

from __future__ import annotations

import shutil
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from omegaconf import DictConfig, OmegaConf

from torchgrasp.config.environments import observed_shapes
from torchgrasp.config.main_phase import MainPhase
from torchgrasp.config.parts import build
from torchgrasp.config.residual import imitation_config
from torchgrasp.config.transition_storage import make_experience
from torchgrasp.errors import CheckpointError
from torchgrasp.modules import ResidualPolicy
from torchgrasp.rollouts import Episode
from torchgrasp.runs import get_rng_state, save_checkpoint, save_weights, set_rng_state
from torchgrasp.runs.checkpoint import load_entry
from torchgrasp.training import ImitationLearner

_RECENT_EPISODES = 200
# The run's own episodes are numbered from here on: none repeats a demonstration.
_FIRST_EPISODE = 1_000_000
_COUNTERS = (
    *("pretrain_steps", "gradient_steps", "env_steps", "iteration"),
    *("env_steps_before", "updates_in_iteration", "next_episode"),
)

LearnerT = TypeVar("LearnerT", bound=ImitationLearner)


class RunState(Generic[LearnerT]):
    """What a checkpoint holds of a run: learner, buffer, noise, counters, random states and results.

    Args:
        cfg: of `training_config`.
        learner: that the recipe drives.
        own: name of the source that the run's episodes are added to.
        successor: makes the learner of the main phase of the one of imitation; None where one learns in both.

    Attributes:
        folder: the run directory.
        experience: what batches are drawn from.
        noise: exploration noise, which decays with the steps taken.
        results: success tables by name, measured before the end.
        pretrain_steps: batches of imitation learned from.
        gradient_steps: all batches learned from.
        env_steps: steps of the run's own episodes.
        iteration: number of the iteration of the main phase.
        env_steps_before: of the steps those before this iteration.
        updates_in_iteration: batches learned from in this iteration.
        next_episode: number of the first episode of the next round.
    """

    folder: Path

    def __init__(
        self,
        cfg: DictConfig,
        learner: ImitationLearner,
        *,
        own: str = "online",
        successor: Callable[[ImitationLearner], LearnerT] | None = None,
    ) -> None:
        self.cfg, self._phase, self._own, self._successor = cfg, MainPhase.of(cfg), own, successor
        self._in_two = successor is not None
        self._learn_by(cast(LearnerT, learner), imitation_config(cfg) if self._in_two else cfg)
        self.noise = build(cfg.collector.noise).to(cfg.device)
        self.results: dict[str, dict] = {}
        self.pretrain_steps = self.gradient_steps = self.env_steps = self.iteration = 0
        self.env_steps_before = self.updates_in_iteration = 0
        self.next_episode = _FIRST_EPISODE
        self._had_episodes = False  # in this iteration, before the run was resumed
        self._recent: deque[bool] = deque(maxlen=_RECENT_EPISODES)
        self._started, self._earlier_seconds = time.monotonic(), 0.0
        self._saved: tuple = ()

    def _learn_by(self, learner: LearnerT, cfg: DictConfig) -> None:
        """Have `learner` learn from now on, of what it reads."""
        self.learner = learner
        self.experience = make_experience(cfg, learner.networks, observed_shapes(cfg), own=self._own)

    def _succeed(self, make: Callable[[ImitationLearner], LearnerT]) -> None:
        """Have the learner of the main phase, made of the one so far, take its place."""
        del self.experience  # its memory, and its files, before others are made
        if self.cfg.replay.folder is not None:
            shutil.rmtree(imitation_config(self.cfg).replay.folder, ignore_errors=True)
        self._learn_by(make(self.learner), self.cfg)
        self._successor = None

    def _has_succeeded(self) -> bool:
        """Whether the checkpoint is of the successor."""
        told = load_entry(self.folder / "checkpoint", "progress") if self._in_two else {}
        return isinstance(told, dict) and told.get("succeeded") is True

    def note_successes(self, episodes: Iterable[Episode]) -> None:
        """Count these episodes of the learner in its success rate."""
        self._recent.extend(episode.success for episode in episodes)

    @property
    def success_rate(self) -> float | None:
        """Of the learner's last 200 episodes; None before the first."""
        return sum(self._recent) / len(self._recent) if self._recent else None

    @property
    def progress(self) -> float:
        """Share of the main phase that is done before this iteration, by updates where it is offline."""
        return self._phase.progress(self.iteration, self.env_steps_before)

    @property
    def learned_nothing(self) -> bool:
        """Whether the main phase is before its first update."""
        return self.iteration == 0 and self.updates_in_iteration == 0

    @property
    def wall_seconds(self) -> float:
        """Seconds spent on this run, those before a resume included."""
        return self._earlier_seconds + time.monotonic() - self._started

    def describe(self) -> dict:
        """Demonstrations, seconds and steps of this run."""
        counts = {name: getattr(self, name) for name in ("wall_seconds", "env_steps", "gradient_steps")}
        return {**self.experience.describe(), **counts}

    def checkpoint(self) -> None:
        """Write everything that a resumed run needs, all or nothing, and the weights as they are now."""
        config: Any = OmegaConf.to_container(self.cfg, resolve=True)
        if not isinstance(self.learner.actor, ResidualPolicy):
            config["model"]["residual"] = None
        save_weights(self.folder / "weights.safetensors", self.learner.networks, config)
        # Last: beside a checkpoint lie weights that are as new.
        save_checkpoint(self.folder / "checkpoint", self._state())
        self._saved = self._identify()

    def _save_changes(self) -> None:
        """Save, unless the last checkpoint holds all of this, as that of a finished run does."""
        if self._saved != self._identify():
            self.checkpoint()

    def _identify(self) -> tuple:
        return (*(getattr(self, name) for name in _COUNTERS), *self.results)

    @property
    def _position(self) -> int:
        return self._phase.position(self.iteration, self.env_steps_before)

    def _begin_next_iteration(self) -> None:
        self.iteration += 1
        self.env_steps_before, self.updates_in_iteration = self.env_steps, 0
        self._had_episodes = False

    def _state(self) -> dict[str, Any]:
        return {
            "learner": self.learner.state_dict(),
            "noise": self.noise.state_dict(),
            "buffer": self.experience.state_dict(),
            "random": get_rng_state(),
            "progress": {
                **{name: getattr(self, name) for name in _COUNTERS},
                "results": self.results,
                "recent": list(self._recent),
                "wall_seconds": self.wall_seconds,
                **({"succeeded": self._successor is None} if self._in_two else {}),
            },
        }

    def _take_up(self, state: dict[str, Any]) -> None:
        try:
            self.learner.load_state_dict(state["learner"])
            self.noise.load_state_dict(state["noise"])
            self.experience.load_state_dict(state["buffer"])
            set_rng_state(state["random"])
            progress = state["progress"]
            for name in _COUNTERS:
                setattr(self, name, progress[name])
            self.results, self._earlier_seconds = progress["results"], progress["wall_seconds"]
            self._recent.extend(progress["recent"])
        except (KeyError, RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0][:200]
            raise CheckpointError(
                f"{self.folder}/checkpoint is of another configuration ({reason}): resume it as it was begun."
            ) from error
        self._had_episodes = self.env_steps > self.env_steps_before
        self._saved = self._identify()
