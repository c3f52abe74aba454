"""What the training recipes do alike: begin or go on, imitate first, run episodes, prove and write down."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import albums
import common
import policies
import predictions
import reports
from imitator import Imitator
from omegaconf import DictConfig
from schedule import count_offline_updates
from sources import Source

from torchgrasp.rollouts.episode_pool import Episode, EpisodePool
from torchgrasp.runs.metrics import MetricsLogger
from torchgrasp.runs.progress import Progress
from torchgrasp.runs.run_directory import write_summary


def make_pool(cfg: DictConfig) -> EpisodePool:
    """The run's workers; what they hand over is enough for all that the run measures."""
    keep = predictions.KEPT if cfg.evaluation.grasp_prediction else common.KEPT
    return common.make_pool(cfg, keep=keep)


def begin(cfg: DictConfig, learner: Imitator, sources: Sequence[Source], run_dir: Path) -> MetricsLogger:
    """Take up the checkpoint in `run_dir`, or where there is none fill the buffer; returns the log."""
    learner.experience.make_buffer(sources)
    resumed = learner.resume(run_dir)
    if not resumed:
        learner.experience.load_demonstrations()
    step = learner.gradient_steps + 1 if resumed else None
    return MetricsLogger(run_dir, resume_step=step, tensorboard=cfg.logger.tensorboard)


def pretrain(
    cfg: DictConfig, learner: Imitator, logger: MetricsLogger, pool: EpisodePool, run_dir: Path
) -> None:
    """Imitation and goal prediction on demonstrations alone (Sec. 3.3); measured where more is to come."""
    progress = Progress(
        cfg.pretrain.steps, initial=learner.pretrain_steps, description="imitation", unit="update"
    )
    if cfg.pretrain.steps:
        learner.experience.draw_demonstrations()
    learner.stopwatch.lap("other")
    while learner.pretrain_steps < cfg.pretrain.steps:
        metrics = learner.pretrain(learner.experience.sample(cfg.pretrain.batch_size))
        learner.stopwatch.lap("updates", 1)
        if learner.pretrain_steps % 50 == 0 or learner.pretrain_steps == cfg.pretrain.steps:
            logger.log(learner.gradient_steps, {**metrics, **learner.stopwatch.measure()})
        if learner.pretrain_steps % cfg.checkpoint.steps == 0:
            learner.checkpoint(run_dir)
        learner.stopwatch.lap("other")
        progress.update()
    progress.close()
    if cfg.pretrain.steps and learner.progress < 1.0:
        measure_once(cfg, learner, pool, run_dir, "policy after imitation alone")


def measure_once(cfg: DictConfig, learner: Imitator, pool: EpisodePool, run_dir: Path, name: str) -> None:
    """Success of the policy as it is now, kept for the end under `name`; a resumed run has it already."""
    if name not in learner.results:
        learner.results[name] = common.evaluate(cfg, pool, learner.policy, name.removeprefix("policy "))
        learner.checkpoint(run_dir)


def take_round(learner: Imitator, rounds: Iterator[list[Episode]]) -> list[Episode]:
    """An iteration's episodes, their steps counted."""
    episodes = next(rounds)
    num_steps = sum(len(episode.steps) for episode in episodes)
    learner.noise.step(num_steps)
    learner.env_steps += num_steps
    learner.stopwatch.lap("rollouts", num_steps, of="env_steps")
    return episodes


class Iterations:
    """The main phase: an iterator that ends it, and `done` writes down what an iteration has brought.

    Args:
        cfg: the recipe's configuration.
        learner: whose counters say how far the phase is.
        logger: of its metrics.
        run_dir: of its checkpoints.
        description: of the progress bar.
    """

    def __init__(
        self, cfg: DictConfig, learner: Imitator, logger: MetricsLogger, run_dir: Path, *, description: str
    ) -> None:
        self._cfg, self._learner, self._logger, self._run_dir = cfg, learner, logger, run_dir
        self._offline = count_offline_updates(cfg)
        self._progress = Progress(
            self._offline or cfg.total_env_steps,
            initial=self._position(),
            description=description,
            unit="update" if self._offline else "step",
        )

    def _position(self) -> int:
        if not self._offline:
            return self._learner.env_steps
        return min(self._offline, self._learner.iterations * self._cfg.online.updates)

    def __iter__(self) -> Iterations:
        return self

    def __next__(self) -> int:
        """The number of the next iteration, whose learning rates are set."""
        learner = self._learner
        if learner.progress >= 1.0:
            learner.checkpoint(self._run_dir)
            self._progress.close()
            raise StopIteration
        learner.set_rates(learner.progress)
        self._before = self._position()
        learner.stopwatch.lap("other")
        return learner.iterations

    def done(self, metrics: dict[str, float]) -> None:
        """Count the iteration; log it with the learner's success rate, and save it in its turn."""
        learner = self._learner
        learner.stopwatch.lap("updates", learner.updates_ahead)
        rate = learner.success_rate
        shown = {} if rate is None else {"train/success_rate": rate}
        shown |= {"env_steps": learner.env_steps, **learner.stopwatch.measure()}
        self._logger.log(learner.gradient_steps, {**metrics, **shown})
        learner.iterations += 1
        if learner.iterations % self._cfg.checkpoint.iterations == 0:
            learner.checkpoint(self._run_dir)
        told = {} if rate is None else {"success_rate": rate}
        self._progress.update(self._position() - self._before, **told)


def conclude(
    cfg: DictConfig, learner: Imitator, logger: MetricsLogger, pool: EpisodePool, run_dir: Path
) -> dict:
    """Measure the policy beside what was measured before and the baselines; write and print the summary."""
    failed, predicted = albums.FailureAlbum(), albums.GraspAlbum()
    tables = {"policy": common.evaluate(cfg, pool, learner.policy, "policy", watch=failed.add)}
    tables |= learner.results
    for name in cfg.evaluation.baselines:
        tables[name] = common.evaluate(cfg, pool, policies.make_policy(cfg, name), name)
    logger.log(learner.gradient_steps + 1, {"test/success_rate": tables["policy"]["success_rate"]})
    logger.close()
    scenes = reports.describe_scenes(cfg)
    summary = {**tables["policy"], "scenes": scenes, "comparison": tables, **learner.describe()}
    pictures = {"Failed episodes": failed.pictures}
    if cfg.evaluation.grasp_prediction:
        networks = predictions.find_predictors(learner.networks)
        summary["grasp_prediction"] = predictions.measure(cfg, pool, networks, predicted)
        pictures = {"Predicted grasps": predicted.pictures, **pictures}
    summary = write_summary(run_dir, summary)
    reports.write_page(cfg, run_dir, summary, pictures)
    reports.print_comparison(cfg, tables)
    reports.print_grasp_prediction(summary)
    print(f"{learner.wall_seconds / 60:.1f} minutes. In {run_dir}: report.html and what it was made of")
    return summary
