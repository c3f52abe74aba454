"""A training run: what its recipe drives."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing
from typing import Any

from omegaconf import DictConfig
from tensordict import TensorDictBase

from torchgrasp.config.demonstration_sources import draws_own_alone
from torchgrasp.config.environments import LEARNED_FROM, make_pool, prepare_objects
from torchgrasp.config.grasp_prediction import PREDICTED_FROM
from torchgrasp.config.main_phase import count_rounds, describe_idle_workers
from torchgrasp.config.overrides import plain
from torchgrasp.config.parts import build
from torchgrasp.config.run_files import keep_configuration, open_run_dir
from torchgrasp.config.run_state import LearnerT, RunState
from torchgrasp.data.demonstration_sources import DemonstrationSource
from torchgrasp.data.folder_lock import own_folder
from torchgrasp.evaluation.run_results import read_scenes
from torchgrasp.evaluation.success_rate import evaluate_policy
from torchgrasp.interruption import UNTIMELY, Interrupted, check, hold, noted, release, watch_signals
from torchgrasp.rollouts import Episode, EpisodePool, collect_rounds
from torchgrasp.rollouts.episode_pool import copy_for_rollouts
from torchgrasp.runs import MetricsLogger, Progress, Stopwatch, load_checkpoint
from torchgrasp.runs.checkpoint import checkpoint_exists
from torchgrasp.runs.loggers import make_logger
from torchgrasp.training import ImitationLearner, cosine_schedule, step_schedule
from torchgrasp.training.cores import updates_on_cores

_LOGGED_EVERY = 50  # updates of imitation
_SCENES = "evaluated_on"


class Run(RunState[LearnerT]):
    """A configuration, its directory, pool of workers, log and learner, and how far they are.

    Entering it makes or finds the directory, starts the workers and prepares the objects. Then `begin` fills
    the buffer or takes up the checkpoint; `pretraining` and `iterations` are the two phases, whose bodies a
    recipe writes; what they have brought is logged and saved between two turns.

    Ctrl-C and SIGTERM are raised as `Interrupted`, from `begin` on only between two updates, while episodes
    are run, and at the end; leaving the run then saves it. One that is resumed goes on with the next update.

    Args:
        cfg: of `training_config`.
        learner: that the recipe drives.
        own: name of the source that the run's episodes are added to.
        successor: makes the learner of the main phase of the one of imitation, see `succeed`; None where one
            learns in both.

    Attributes:
        pool: who runs episodes.
        log: metrics.csv, and the logger configured.
        expert_start: lets the expert begin some of the learner's episodes; None where it does not.
        tries: proposes last actions to try besides the learner's own; None where there are none.
    """

    pool: EpisodePool
    log: MetricsLogger

    def __init__(
        self,
        cfg: DictConfig,
        learner: ImitationLearner,
        *,
        own: str = "online",
        successor: Callable[[ImitationLearner], LearnerT] | None = None,
    ) -> None:
        super().__init__(cfg, learner, own=own, successor=successor)
        self.expert_start = build(cfg.collector.expert_start)
        self.tries = build(cfg.collector.get("tries"))
        self.stopwatch = Stopwatch()
        self._rounds: Generator[list[Episode], None, None] | None = None
        self._worked = 0.0  # seconds of the workers before this iteration
        steps = cfg.pretrain.steps
        self._imitation_rate = cosine_schedule(max(1, steps), warmup_steps=min(200, steps // 10))
        milestones = dict.fromkeys(round(1000 * share) for share in cfg.online.milestones)  # may round to one
        self._main_rate = step_schedule([*milestones], gamma=cfg.online.decay)
        self._resources, self._begun = ExitStack(), False

    def __enter__(self) -> Run[LearnerT]:
        with ExitStack() as opened:
            opened.enter_context(watch_signals())
            self.folder = open_run_dir(self.cfg, self.cfg.recipe)
            opened.enter_context(own_folder(self.folder))
            networks = self.learner.networks.values() if self.cfg.compile is None else []
            print(opened.enter_context(updates_on_cores(networks, self.cfg.device)))
            keep = PREDICTED_FROM if self.cfg.evaluation.grasp_prediction else LEARNED_FROM
            self.pool = opened.enter_context(make_pool(self.cfg, keep=keep))
            with noted(self._way_on):
                prepare_objects(self.cfg)
            self._resources = opened.pop_all()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, UNTIMELY) or (error is not None and checkpoint_exists(self.folder)):
            error.add_note(self._way_on)
        with self._resources:
            if isinstance(error, Interrupted) and self._begun:
                with noted(self._way_on):  # there may be no room
                    self._save_changes()

    @property
    def _way_on(self) -> str:
        return f"The run goes on with resume={self.folder}"

    def begin(self, sources: Sequence[DemonstrationSource]) -> None:
        """Take up the checkpoint of the directory, or where there is none fill the buffer; open the log."""
        self._sources, resumed = list(sources), checkpoint_exists(self.folder)
        if self._successor is not None and resumed and self._has_succeeded():
            self._succeed(self._successor)
            sources = self._read_after_imitation()
        self.experience.make_buffer(sources)
        if resumed:
            self._take_up(load_checkpoint(self.folder / "checkpoint", like=self._state()))
        else:
            self.experience.load_demonstrations()
        step = self.gradient_steps + 1 if resumed else None
        logger = make_logger(run_dir=self.folder, resume_step=step, **plain(self.cfg.logger))
        self.log = MetricsLogger(self.folder, resume_step=step, logger=logger)
        if self.cfg.resume is not None:  # not before it is known to work
            keep_configuration(self.cfg, self.folder)
        self._resources.callback(self.log.close)
        self._resources.enter_context(hold())
        self._begun = True

    def pretraining(self) -> Iterator[TensorDictBase]:
        """Batches of labelled demonstrations for `pretrain.steps` updates at that phase's rate (Sec. 3.3)."""
        pretrain, every = self.cfg.pretrain, self.cfg.checkpoint.steps
        if pretrain.steps:
            self.experience.draw_demonstrations()
        batches = self.experience.batches(pretrain.steps - self.pretrain_steps, pretrain.batch_size)
        with (
            closing(batches),
            Progress(
                pretrain.steps, initial=self.pretrain_steps, description="imitation", unit="update"
            ) as progress,
        ):
            while self.pretrain_steps < pretrain.steps:
                check()
                self.learner.set_rate(pretrain.learning_rate * self._imitation_rate(self.pretrain_steps))
                with self.stopwatch.part("updates"):
                    yield next(batches)
                self.stopwatch.count("updates", 1)
                self.pretrain_steps += 1
                self.gradient_steps += 1
                if self.pretrain_steps % _LOGGED_EVERY == 0 or self.pretrain_steps == pretrain.steps:
                    self._log_terms()
                if self.pretrain_steps % every == 0:
                    self.checkpoint()
                progress.update()

    def succeed(self) -> None:
        """From here on the successor learns, of the same demonstrations.

        Nothing changes where there is none, and at the end of a run, which has no main phase then.
        """
        if self._successor is None or self.progress >= 1.0:
            return
        self._succeed(self._successor)
        self.experience.make_buffer(self._read_after_imitation())
        self.experience.load_demonstrations()

    def _read_after_imitation(self) -> list[DemonstrationSource]:
        """The demonstrations that the main phase learns from, none where it draws own episodes alone."""
        return [] if draws_own_alone(self.cfg) else self._sources

    def act(self, *actors: Callable) -> None:
        """From now on `episodes` are those of the actors, in turn by iteration; without any, none."""
        if not actors:
            return
        if self.progress < 1.0 and (note := describe_idle_workers(self.cfg)) is not None:
            print(note)
        length, self._worked = count_rounds(self.cfg), self.pool.work_seconds
        first, turn = self.next_episode, self.iteration + self._had_episodes
        self._rounds = collect_rounds(
            self.pool,
            "train",
            lambda number: copy_for_rollouts(actors[(turn + (number - first) // length) % len(actors)]),
            first=first,
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
                check()
                before = self._position
                self.learner.set_rate(
                    self.cfg.online.learning_rate * self._main_rate(round(1000 * self.progress))
                )
                self.experience.anneal(self.progress)
                yield self.iteration
                self._end_iteration()
                told = {} if self.success_rate is None else {"success_rate": self.success_rate}
                progress.update(self._position - before, **told)
        self._save_changes()

    def episodes(self) -> list[Episode]:
        """This iteration's episodes, their steps counted; none where nobody acts, or they came before."""
        if self._rounds is None or self._had_episodes:
            return []
        with self.stopwatch.part("rollouts"):
            with release():  # nothing of them is kept before all are there
                episodes = next(self._rounds)
            num_steps = sum(len(episode.steps) for episode in episodes)
            self.noise.step(num_steps)
        self.env_steps += num_steps
        self.next_episode += count_rounds(self.cfg)
        self.stopwatch.count("rollouts", num_steps, of="env_steps")
        return episodes

    def batches(self) -> Iterator[TensorDictBase]:
        """This iteration's batches that are to come: `online.updates`, or the last ones of an offline run."""
        number = self._phase.updates_ahead(self.iteration)
        batches = self.experience.batches(number - self.updates_in_iteration)
        with self.stopwatch.part("updates"), closing(batches):
            while self.updates_in_iteration < number:
                check()
                self.gradient_steps += 1
                yield next(batches)
                self.updates_in_iteration += 1
                self.stopwatch.count("updates", 1)

    def measure_once(self, name: str) -> None:
        """Success of the policy as it is now, kept for the end under `name`; a resumed run has it already."""
        if name not in self.results:
            table = self.evaluate(self.learner.policy, name.removeprefix("policy "))
            self.results[name] = {**table, _SCENES: read_scenes(plain(self.cfg))}
            self.checkpoint()

    def find_comparable(self) -> dict[str, dict]:
        """What was measured before, by name; left out, and named, is what was measured on other scenes.

        A run may be resumed with another evaluation.
        """
        scenes, tables = read_scenes(plain(self.cfg)), {}
        for name, table in self.results.items():
            if table.get(_SCENES) == scenes:
                tables[name] = {key: value for key, value in table.items() if key != _SCENES}
            else:
                print(f"{name} was measured on other scenes than this evaluation's: it is left out.")
        return tables

    def evaluate(self, policy: Callable, description: str, **options: Any) -> dict:
        """Success of a policy on the evaluation's scenes; see `evaluate_policy`."""
        evaluation = self.cfg.evaluation
        with release():
            return evaluate_policy(
                self.pool,
                policy,
                num_episodes=evaluation.episodes,
                num_envs=evaluation.num_envs,
                description=description,
                **options,
            )

    def _end_iteration(self) -> None:
        """Log the iteration with the learner's success rate, and save it in its turn."""
        rate = self.success_rate
        shown = {} if rate is None else {"train/success_rate": rate}
        worked, self._worked = self._worked, self.pool.work_seconds
        if self._worked > worked:
            shown["time/workers_s"] = self._worked - worked
        self._log_terms(**shown, env_steps=self.env_steps)
        self._begin_next_iteration()
        if self.iteration % self.cfg.checkpoint.iterations == 0:
            self.checkpoint()

    def _log_terms(self, **more: float) -> None:
        with self.stopwatch.part("updates"):  # a GPU may have them still to do
            terms = self.learner.fetch_terms()
        self.log.log(self.gradient_steps, {**terms, **more, **self.stopwatch.measure()})
