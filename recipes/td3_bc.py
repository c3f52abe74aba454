"""Goal-auxiliary actor-critic: demonstrations, imitation, reinforcement with DAgger labels, the proof.

python recipes/td3_bc.py                      # minutes on two cores (experiment=laptop)
python recipes/td3_bc.py experiment=paper     # Sec. 6.4 to the letter
python recipes/td3_bc.py resume=outputs/td3_bc/<date_time>
"""

from __future__ import annotations

from pathlib import Path

import albums
import collect
import common
import hydra
import policies
import reports
import settings
from learner import Learner
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictSequential

from torchgrasp.training import (
    EpisodePool,
    MetricsLogger,
    Progress,
    one_line_errors,
    save_weights,
    write_summary,
)


def train(cfg: DictConfig) -> dict:
    """Run the whole recipe, or the rest of the run that `resume` names; returns the summary."""
    cfg = settings.resumed(cfg)
    learner = Learner(cfg, common.observed_shapes(cfg))
    run_dir = settings.open_run(cfg, "td3_bc")
    with common.make_pool(cfg) as pool:
        common.prepare_objects(cfg)
        path = collect.demonstrations(cfg, pool, run_dir)
        learner.make_buffer(path)
        resumed = learner.resume(run_dir)
        if not resumed:
            learner.load_demonstrations()
        logger = MetricsLogger(
            run_dir,
            resume_step=learner.gradient_steps + 1 if resumed else None,
            tensorboard=cfg.logger.tensorboard,
        )
        pretrain(cfg, learner, logger, run_dir)
        if cfg.pretrain.steps and cfg.total_env_steps and "bc" not in learner.results:
            learner.results["bc"] = common.evaluate(cfg, pool, learner.policy, "imitation alone")
            learner.checkpoint(run_dir)
        reinforce(cfg, learner, logger, pool, run_dir)
        save_weights(
            run_dir / "weights.safetensors",
            learner.networks,
            OmegaConf.to_container(cfg, resolve=True),  # pyright: ignore[reportArgumentType]
        )
        return conclude(cfg, learner, logger, pool, run_dir)


def pretrain(cfg: DictConfig, learner: Learner, logger: MetricsLogger, run_dir: Path) -> None:
    """Imitation and goal prediction on D_expert alone (Sec. 3.3)."""
    progress = Progress(
        cfg.pretrain.steps, initial=learner.pretrain_steps, description="imitation", unit="update"
    )
    learner.begin_imitation()
    while learner.pretrain_steps < cfg.pretrain.steps:
        metrics = learner.imitate(learner.buffer.sample(cfg.pretrain.batch_size).to(cfg.device))
        if learner.pretrain_steps % 50 == 0 or learner.pretrain_steps == cfg.pretrain.steps:
            logger.log(learner.gradient_steps, metrics)
        if learner.pretrain_steps % cfg.checkpoint.steps == 0:
            learner.checkpoint(run_dir)
        progress.update()
    progress.close()


def reinforce(
    cfg: DictConfig, learner: Learner, logger: MetricsLogger, pool: EpisodePool, run_dir: Path
) -> None:
    """Rollouts of the learner, labelled by the expert, and TD3+BC on the mixture (Sec. 3.4, 3.5, 6.4)."""
    labels = common.make_expert(cfg, "train", execute=False)  # first: an actor may read its goal
    modules: list = [labels, learner.actor, learner.noise, learner.expert_start]
    rounds = common.rounds(cfg, pool, TensorDictSequential(*modules), learner.iterations)
    progress = Progress(cfg.total_env_steps, initial=learner.env_steps, description="reinforcement")
    learner.begin_reinforcement()
    while learner.env_steps < cfg.total_env_steps:
        learner.set_rates(learner.env_steps / cfg.total_env_steps)
        episodes = next(rounds)
        num_steps = sum(len(episode.steps) for episode in episodes)
        for episode in episodes:
            learner.buffer.extend(episode.steps[None], source="online")
        learner.noise.step(num_steps)
        learner.env_steps += num_steps
        learner.iterations += 1
        success_rate = learner.note_successes([episode.success for episode in episodes])

        metrics: dict[str, float] = {}
        for update in range(1, cfg.online.updates + 1):
            batch = learner.buffer.sample().to(cfg.device)
            metrics |= learner.update_critic(batch)
            if update % cfg.online.policy_delay == 0:
                metrics |= learner.update_actor(batch)

        logger.log(
            learner.gradient_steps,
            {**metrics, "env_steps": learner.env_steps, "train/success_rate": success_rate},
        )
        if learner.iterations % cfg.checkpoint.iterations == 0:
            learner.checkpoint(run_dir)
        progress.update(num_steps, success_rate=success_rate)
    rounds.close()
    learner.checkpoint(run_dir)
    progress.close()


def conclude(
    cfg: DictConfig, learner: Learner, logger: MetricsLogger, pool: EpisodePool, run_dir: Path
) -> dict:
    """Measure the policy beside the baselines on the same scenes; write and print summary.json."""
    failed = albums.FailureAlbum()
    tables = {"policy": common.evaluate(cfg, pool, learner.policy, "policy", watch=failed.add)}
    if "bc" in learner.results:
        tables["policy after imitation alone"] = learner.results["bc"]
    for name in cfg.evaluation.baselines:
        tables[name] = common.evaluate(cfg, pool, policies.make_policy(cfg, name), name)
    logger.log(learner.gradient_steps + 1, {"test/success_rate": tables["policy"]["success_rate"]})
    logger.close()
    scenes = reports.describe_scenes(cfg)
    summary = {**tables["policy"], "scenes": scenes, "comparison": tables, **learner.describe()}
    reports.print_comparison(cfg, tables)
    print(f"{learner.wall_seconds / 60:.1f} minutes. In {run_dir}: report.html and what it was made of")
    summary = write_summary(run_dir, summary)
    reports.write_page(cfg, run_dir, summary, {"Failed episodes": failed.pictures})
    return summary


@hydra.main(version_base=None, config_path="../conf", config_name="td3_bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Train as configured."""
    train(cfg)


if __name__ == "__main__":
    main()
