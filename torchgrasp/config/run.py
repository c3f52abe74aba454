"""A training run: what its recipe drives, and what a checkpoint holds of it."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Generic, TypeVar

from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase

from torchgrasp.config.environments import LEARNED_FROM, make_pool, observed_shapes, prepare_objects
from torchgrasp.config.grasp_prediction import PREDICTED_FROM
from torchgrasp.config.main_phase import MainPhase, count_rounds
from torchgrasp.config.overrides import plain
from torchgrasp.config.parts import build
from torchgrasp.config.run_files import open_run_dir
from torchgrasp.config.transition_storage import make_experience
from torchgrasp.data.demonstration_sources import DemonstrationSource
from torchgrasp.errors import CheckpointError
from torchgrasp.evaluation.success_rate import evaluate_policy
from torchgrasp.rollouts import Episode, EpisodePool, collect_rounds
from torchgrasp.rollouts.episode_pool import copy_for_rollouts
from torchgrasp.runs import (
    MetricsLogger,
    Progress,
    Stopwatch,
    get_rng_state,
    load_checkpoint,
    save_checkpoint,
    save_weights,
    set_rng_state,
)
from torchgrasp.runs.checkpoint import checkpoint_exists
from torchgrasp.runs.loggers import make_logger
from torchgrasp.training import ImitationLearner, cosine_schedule, step_schedule

# Online episodes are numbered from here on: none repeats a demonstration.
_FIRST_EPISODE = 1_000_000
_RECENT_EPISODES = 200
_LOGGED_EVERY = 50  # updates of imitation
_COUNTERS = ("pretrain_steps", "gradient_steps", "env_steps", "iteration")

LearnerT = TypeVar("LearnerT", bound=ImitationLearner)


class Run(Generic[LearnerT]):
    """A configuration, its directory, pool of workers, log and learner, and how far they are.

    Entering it makes or finds the directory, starts the workers and prepares the objects. Then `begin` fills
    the buffer or takes up the checkpoint; `pretraining` and `iterations` are the two phases, whose bodies a
    recipe writes; what they have brought is logged and saved between two turns.

    Args:
        cfg: of `training_config`.
        learner: that the recipe drives.
        own: name of the source that the run's episodes are added to.

    Attributes:
        folder: the run directory.
        pool: who runs episodes.
        log: metrics.csv, and the logger configured.
        experience: what batches are drawn from.
        noise: exploration noise, which decays with the steps taken.
        expert_start: lets the expert begin some of the learner's episodes.
        results: success tables by name, measured before the end.
        iteration: number of the iteration of the main phase.
        gradient_steps: batches learned from.
        env_steps: steps of the run's own episodes.
    """

    folder: Path
    pool: EpisodePool
    log: MetricsLogger

    def __init__(self, cfg: DictConfig, learner: LearnerT, *, own: str = "online") -> None:
        self.cfg, self.learner, self._phase = cfg, learner, MainPhase.of(cfg)
        self.experience = make_experience(cfg, learner.networks, observed_shapes(cfg), own=own)
        self.noise = build(cfg.collector.noise).to(cfg.device)
        self.expert_start = build(cfg.collector.expert_start)
        self.results: dict[str, dict] = {}
        self.stopwatch = Stopwatch()
        self.pretrain_steps = self.gradient_steps = self.env_steps = self.iteration = 0
        self._recent: deque[bool] = deque(maxlen=_RECENT_EPISODES)
        self._rounds: Generator[list[Episode], None, None] | None = None
        self._started, self._earlier_seconds = time.monotonic(), 0.0
        steps = cfg.pretrain.steps
        self._imitation_rate = cosine_schedule(max(1, steps), warmup_steps=min(200, steps // 10))
        milestones = dict.fromkeys(round(1000 * share) for share in cfg.online.milestones)  # may round to one
        self._main_rate = step_schedule([*milestones], gamma=cfg.online.decay)
        self._resources = ExitStack()

    def __enter__(self) -> Run[LearnerT]:
        with ExitStack() as opened:
            self.folder = open_run_dir(self.cfg, self.cfg.recipe)
            keep = PREDICTED_FROM if self.cfg.evaluation.grasp_prediction else LEARNED_FROM
            self.pool = opened.enter_context(make_pool(self.cfg, keep=keep))
            prepare_objects(self.cfg)
            self._resources = opened.pop_all()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._resources.close()
        if error is not None and checkpoint_exists(self.folder):
            print(f"The run goes on with resume={self.folder}", file=sys.stderr)

    def begin(self, sources: Sequence[DemonstrationSource]) -> None:
        """Take up the checkpoint of the directory, or where there is none fill the buffer; open the log."""
        self.experience.make_buffer(sources)
        resumed = checkpoint_exists(self.folder)
        if resumed:
            self._take_up(load_checkpoint(self.folder / "checkpoint"))
        else:
            self.experience.load_demonstrations()
        step = self.gradient_steps + 1 if resumed else None
        logger = make_logger(run_dir=self.folder, resume_step=step, **plain(self.cfg.logger))
        self.log = MetricsLogger(self.folder, resume_step=step, logger=logger)
        self._resources.callback(self.log.close)

    def pretraining(self) -> Iterator[TensorDictBase]:
        """Batches of labelled demonstrations for `pretrain.steps` updates at that phase's rate (Sec. 3.3)."""
        pretrain, every = self.cfg.pretrain, self.cfg.checkpoint.steps
        if pretrain.steps:
            self.experience.draw_demonstrations()
        with Progress(
            pretrain.steps, initial=self.pretrain_steps, description="imitation", unit="update"
        ) as progress:
            while self.pretrain_steps < pretrain.steps:
                self.learner.set_rate(pretrain.learning_rate * self._imitation_rate(self.pretrain_steps))
                with self.stopwatch.part("updates"):
                    yield self.experience.sample(pretrain.batch_size)
                self.stopwatch.count("updates", 1)
                self.pretrain_steps += 1
                self.gradient_steps += 1
                if self.pretrain_steps % _LOGGED_EVERY == 0 or self.pretrain_steps == pretrain.steps:
                    self._log_terms()
                if self.pretrain_steps % every == 0:
                    self.checkpoint()
                progress.update()

    def act(self, *actors: Callable) -> None:
        """From now on `episodes` are those of the actors, in turn by iteration; without any, none."""
        if not actors:
            return
        length = count_rounds(self.cfg)
        self._rounds = collect_rounds(
            self.pool,
            "train",
            lambda number: copy_for_rollouts(actors[(number - _FIRST_EPISODE) // length % len(actors)]),
            first=_FIRST_EPISODE + self.iteration * length,
            length=length,
            overlap=self.cfg.collector.overlap,
        )
        self._resources.callback(self._rounds.close)

    def iterations(self, description: str) -> Iterator[int]:
        """The numbers of the main phase's iterations, at its rates (Sec. 6.4); saves and logs after each."""
        phase = self._phase
        with Progress(
            phase.length, initial=self._position, description=description, unit=phase.unit
        ) as progress:
            while self.progress < 1.0:
                before = self._position
                self.learner.set_rate(
                    self.cfg.online.learning_rate * self._main_rate(round(1000 * self.progress))
                )
                self.experience.anneal(self.progress)
                yield self.iteration
                self._end_iteration()
                told = {} if self.success_rate is None else {"success_rate": self.success_rate}
                progress.update(self._position - before, **told)
        self.checkpoint()

    def episodes(self) -> list[Episode]:
        """This iteration's episodes, their steps counted; none where nobody acts."""
        if self._rounds is None:
            return []
        with self.stopwatch.part("rollouts"):
            episodes = next(self._rounds)
            num_steps = sum(len(episode.steps) for episode in episodes)
            self.noise.step(num_steps)
        self.env_steps += num_steps
        self.stopwatch.count("rollouts", num_steps, of="env_steps")
        return episodes

    def batches(self) -> Iterator[TensorDictBase]:
        """This iteration's batches: `online.updates`, or the last ones of an offline run."""
        number = self._phase.updates_ahead(self.iteration)
        with self.stopwatch.part("updates"):
            for _ in range(number):
                self.gradient_steps += 1
                yield self.experience.sample()
        self.stopwatch.count("updates", number)

    def note_successes(self, episodes: Iterable[Episode]) -> None:
        """Count these episodes of the learner in its success rate."""
        self._recent.extend(episode.success for episode in episodes)

    @property
    def success_rate(self) -> float | None:
        """Of the learner's last 200 episodes; None before the first."""
        return sum(self._recent) / len(self._recent) if self._recent else None

    @property
    def progress(self) -> float:
        """Share of the main phase that is done, by updates where it is offline, else by steps."""
        return self._phase.progress(self.iteration, self.env_steps)

    @property
    def wall_seconds(self) -> float:
        """Seconds spent on this run, those before a resume included."""
        return self._earlier_seconds + time.monotonic() - self._started

    def measure_once(self, name: str) -> None:
        """Success of the policy as it is now, kept for the end under `name`; a resumed run has it already."""
        if name not in self.results:
            self.results[name] = self.evaluate(self.learner.policy, name.removeprefix("policy "))
            self.checkpoint()

    def evaluate(self, policy: Callable, description: str, **options: Any) -> dict:
        """Success of a policy on the evaluation's scenes; see `evaluate_policy`."""
        evaluation = self.cfg.evaluation
        return evaluate_policy(
            self.pool,
            policy,
            num_episodes=evaluation.episodes,
            num_envs=evaluation.num_envs,
            description=description,
            **options,
        )

    def checkpoint(self) -> None:
        """Write everything that a resumed run needs, all or nothing, and the weights as they are now."""
        save_checkpoint(self.folder / "checkpoint", self._state())
        config: Any = OmegaConf.to_container(self.cfg, resolve=True)
        save_weights(self.folder / "weights.safetensors", self.learner.networks, config)

    def describe(self) -> dict:
        """Demonstrations, seconds and steps of this run."""
        counts = {name: getattr(self, name) for name in ("wall_seconds", "env_steps", "gradient_steps")}
        return {**self.experience.describe(), **counts}

    @property
    def _position(self) -> int:
        return self._phase.position(self.iteration, self.env_steps)

    def _end_iteration(self) -> None:
        """Log the iteration with the learner's success rate, and save it in its turn."""
        rate = self.success_rate
        shown = {} if rate is None else {"train/success_rate": rate}
        self._log_terms(**shown, env_steps=self.env_steps)
        self.iteration += 1
        if self.iteration % self.cfg.checkpoint.iterations == 0:
            self.checkpoint()

    def _log_terms(self, **more: float) -> None:
        self.log.log(self.gradient_steps, {**self.learner.fetch_terms(), **more, **self.stopwatch.measure()})

    def _state(self) -> dict[str, Any]:
        return {
            "learner": self.learner.state_dict(),
            "noise": self.noise.state_dict(),
            "buffer": self.experience.buffer.state_dict(),
            "random": get_rng_state(),
            "progress": {
                **{name: getattr(self, name) for name in _COUNTERS},
                "results": self.results,
                "recent": list(self._recent),
                "wall_seconds": self.wall_seconds,
            },
        }

    def _take_up(self, state: dict[str, Any]) -> None:
        try:
            self.learner.load_state_dict(state["learner"])
            self.noise.load_state_dict(state["noise"])
            self.experience.buffer.load_state_dict(state["buffer"])
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
