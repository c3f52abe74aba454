"""Hindsight goals: a trained policy goes on on objects of which no model is known (Algorithm 1, Sec. 6.1).

python recipes/hindsight.py init=outputs/td3_bc/<run>                          # the YCB objects
python recipes/hindsight.py init=outputs/td3_bc/<run> physics=low_friction
python recipes/hindsight.py init=outputs/td3_bc/<run> objects=procedural

Nothing here knows an expert: its episodes have no goal but where their own hand has grasped, and no label but
what they did themselves where it succeeded, with `online.self_imitation=true`.
"""

from __future__ import annotations

from pathlib import Path

import common
import hydra
import settings
import stages
from inherit import begun_with
from learner import Learner
from omegaconf import DictConfig
from origin import take_given
from sources import list_demonstrations
from tensordict.nn import TensorDictSequential

from torchgrasp.config.one_line_errors import one_line_errors
from torchgrasp.rollouts.episode_pool import EpisodePool
from torchgrasp.runs.metrics import MetricsLogger
from torchgrasp.transforms import HindsightGoal


def train(cfg: DictConfig) -> dict:
    """Run the whole recipe, or the rest of the run that `resume` names; returns the summary."""
    cfg = begun_with(settings.resumed(cfg, "hindsight"))
    learner = Learner(cfg, common.observed_shapes(cfg), own="hindsight")
    known = [take_given(each, name) for name, each in list_demonstrations(cfg).items()]
    run_dir = settings.open_run(cfg, "hindsight")
    with stages.make_pool(cfg) as pool:
        common.prepare_objects(cfg)
        logger = stages.begin(cfg, learner, known, run_dir)
        stages.measure_once(cfg, learner, pool, run_dir, "policy before fine-tuning")
        tune(cfg, learner, logger, pool, run_dir)
        return stages.conclude(cfg, learner, logger, pool, run_dir)


def tune(cfg: DictConfig, learner: Learner, logger: MetricsLogger, pool: EpisodePool, run_dir: Path) -> None:
    """Algorithm 1 with D = D_expert of known objects and D_hindsight, by Eq. (5)."""
    modules: list = [learner.policy, learner.noise]
    rounds = common.rounds(cfg, pool, TensorDictSequential(*modules), first=learner.iterations)
    relabel = HindsightGoal(imitate=cfg.online.self_imitation)
    learner.begin_reinforcement()
    iterations = stages.Iterations(cfg, learner, logger, run_dir, description="fine-tuning")
    for _ in iterations:
        episodes = stages.take_round(learner, rounds)
        learner.note_successes(episodes)
        for episode in episodes:
            relabel(episode.steps)  # where it succeeded, the pose that it reached; on demand its actions too
            learner.experience.add(episode)

        iterations.done(learner.reinforce())
    rounds.close()


@hydra.main(version_base=None, config_path="../conf", config_name="hindsight")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Fine-tune as configured."""
    train(cfg)


if __name__ == "__main__":
    main()
