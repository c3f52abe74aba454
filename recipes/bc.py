"""Imitation: demonstrations, then fresh episodes of the expert, of the learner with its labels, or none.

python recipes/bc.py                                          # online, with DAgger and the auxiliary goal
python recipes/bc.py 'online.rollouts=[expert]'               # online, without DAgger
python recipes/bc.py offline.updates=auto                     # D_expert alone
python recipes/bc.py model.actor.goal_prediction=false        # without the auxiliary goal
"""

from __future__ import annotations

from pathlib import Path

import collect
import common
import hydra
import settings
import stages
from behaviour import DISTURBANCE, check_behaviour
from imitator import Imitator
from omegaconf import DictConfig, ListConfig
from tensordict.nn import TensorDictModuleBase, TensorDictSequential

from torchgrasp.config.one_line_errors import one_line_errors
from torchgrasp.errors import ConfigError
from torchgrasp.rollouts.episode_pool import EpisodePool
from torchgrasp.runs.metrics import MetricsLogger

ROLLOUTS = ("expert", "learner")


def train(cfg: DictConfig) -> dict:
    """Run the whole recipe, or the rest of the run that `resume` names; returns the summary."""
    cfg = settings.resumed(cfg, "bc")
    check_rollouts(cfg)
    learner = Imitator(cfg, common.observed_shapes(cfg))
    run_dir = settings.open_run(cfg, "bc")
    with stages.make_pool(cfg) as pool:
        common.prepare_objects(cfg)
        logger = stages.begin(cfg, learner, collect.demonstrations(cfg, pool, run_dir), run_dir)
        stages.pretrain(cfg, learner, logger, pool, run_dir)
        imitate(cfg, learner, logger, pool, run_dir)
        return stages.conclude(cfg, learner, logger, pool, run_dir)


def check_rollouts(cfg: DictConfig) -> None:
    """Refuse rollouts of somebody else, and nobody's where the run is online."""
    given = cfg.online.rollouts
    named = isinstance(given, ListConfig) and set(given) <= set(ROLLOUTS)
    if not named or not (given or cfg.offline.updates):
        raise ConfigError(
            f"online.rollouts={given}: name those who act in turn, of [{', '.join(ROLLOUTS)}], or give "
            "offline.updates=auto for demonstrations alone."
        )
    if cfg.offline.updates:
        return
    kind, reader = _acted_kind(cfg), f"online.rollouts={given}"
    if "expert" in given and kind in DISTURBANCE:
        check_behaviour(cfg, DISTURBANCE[kind], reader, "or leave expert out of the rollouts")
    if "learner" in given:
        check_behaviour(cfg, "expert_start", reader, "or leave learner out of the rollouts")


def _acted_kind(cfg: DictConfig) -> str:
    """How the expert acts in fresh episodes: disturbed, unless it was not in the demonstrations."""
    return "expert" if cfg.demonstrations.kind == "expert" else "perturbed"


def make_actors(cfg: DictConfig, learner: Imitator) -> list[TensorDictModuleBase]:
    """Who acts in turn, as `online.rollouts` says; each state is labelled by the expert. Offline nobody."""
    if cfg.offline.updates:
        return []
    labels = common.make_expert(cfg, "train", execute=False)  # first: an actor may read its goal
    modules: list = [labels, learner.actor, learner.noise, learner.expert_start]
    actors = {
        "expert": lambda: collect.make_demonstrator(cfg, _acted_kind(cfg)),
        "learner": lambda: TensorDictSequential(*modules),
    }
    return [actors[name]() for name in cfg.online.rollouts]


def imitate(
    cfg: DictConfig, learner: Imitator, logger: MetricsLogger, pool: EpisodePool, run_dir: Path
) -> None:
    """Episodes by the expert and the learner in turn (Sec. 3.3, 3.5), and L_BC and L_AUX on the mixture.

    Offline there are no episodes: the same updates on demonstrations alone.
    """
    rounds = common.rounds(cfg, pool, *make_actors(cfg, learner), first=learner.iterations)
    learner.experience.draw_all(labelled=True)
    iterations = stages.Iterations(cfg, learner, logger, run_dir, description="more imitation")
    for number in iterations:
        if not cfg.offline.updates:
            actor = cfg.online.rollouts[number % len(cfg.online.rollouts)]
            episodes = stages.take_round(learner, rounds)
            learner.note_successes(episodes if actor == "learner" else ())
            for episode in episodes:
                if actor == "learner" or episode.success:  # D_expert holds successes alone (Sec. 6.4)
                    learner.experience.add(episode)

        metrics: dict[str, float] = {}
        for _ in range(learner.updates_ahead):
            metrics |= learner.imitate(learner.experience.sample())
        iterations.done(metrics)
    rounds.close()


@hydra.main(version_base=None, config_path="../conf", config_name="bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Train as configured."""
    train(cfg)


if __name__ == "__main__":
    main()
