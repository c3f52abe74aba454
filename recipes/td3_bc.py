"""Goal-auxiliary actor-critic: demonstrations, imitation, reinforcement with DAgger labels, the proof.

python recipes/td3_bc.py                         # minutes on two cores (experiment=laptop)
python recipes/td3_bc.py experiment=paper        # Sec. 6.4 to the letter
python recipes/td3_bc.py offline.updates=5000    # from demonstrations alone
python recipes/td3_bc.py resume=outputs/td3_bc/<date_time>
"""

from __future__ import annotations

from pathlib import Path

import collect
import common
import hydra
import settings
import stages
from behaviour import check_behaviour
from learner import Learner
from omegaconf import DictConfig
from sources import without_expert
from tensordict.nn import TensorDictModuleBase, TensorDictSequential

from torchgrasp.config.one_line_errors import one_line_errors
from torchgrasp.rollouts.episode_pool import EpisodePool
from torchgrasp.runs.metrics import MetricsLogger


def train(cfg: DictConfig) -> dict:
    """Run the whole recipe, or the rest of the run that `resume` names; returns the summary."""
    cfg = settings.resumed(cfg, "td3_bc")
    if not cfg.offline.updates:
        check_behaviour(cfg, "expert_start", "the learner's episodes")
    learner = Learner(cfg, common.observed_shapes(cfg))
    run_dir = settings.open_run(cfg, "td3_bc")
    with stages.make_pool(cfg) as pool:
        common.prepare_objects(cfg)
        logger = stages.begin(cfg, learner, collect.demonstrations(cfg, pool, run_dir), run_dir)
        stages.pretrain(cfg, learner, logger, pool, run_dir)
        reinforce(cfg, learner, logger, pool, run_dir)
        return stages.conclude(cfg, learner, logger, pool, run_dir)


def make_actors(cfg: DictConfig, learner: Learner) -> list[TensorDictModuleBase]:
    """The learner, whose states the expert labels; offline nobody."""
    if cfg.offline.updates:
        return []
    labels = common.make_expert(cfg, "train", execute=False)  # first: an actor may read its goal
    modules: list = [labels, learner.actor, learner.noise, learner.expert_start]
    return [TensorDictSequential(*modules)]


def reinforce(
    cfg: DictConfig, learner: Learner, logger: MetricsLogger, pool: EpisodePool, run_dir: Path
) -> None:
    """Rollouts of the learner, labelled by the expert, and TD3+BC on the mixture (Sec. 3.4, 3.5, 6.4).

    Offline there are no rollouts: the same updates on demonstrations alone.
    """
    rounds = common.rounds(cfg, pool, *make_actors(cfg, learner), first=learner.iterations)
    learner.begin_reinforcement()
    iterations = stages.Iterations(cfg, learner, logger, run_dir, description="reinforcement")
    for _ in iterations:
        if not cfg.offline.updates:
            episodes = stages.take_round(learner, rounds)
            learner.note_successes(episodes)
            for episode in episodes:
                if not cfg.online.dagger:
                    without_expert(episode.steps)
                learner.experience.add(episode)

        iterations.done(learner.reinforce())
    rounds.close()


@hydra.main(version_base=None, config_path="../conf", config_name="td3_bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Train as configured."""
    train(cfg)


if __name__ == "__main__":
    main()
