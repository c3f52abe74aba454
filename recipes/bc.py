"""Imitation: demonstrations, then fresh episodes of the expert, of the learner with its labels, or none.

python recipes/bc.py                                          # online, with DAgger and the auxiliary goal
python recipes/bc.py 'online.rollouts=[expert]'               # online, without DAgger
python recipes/bc.py offline.updates=auto                     # D_expert alone
python recipes/bc.py model.actor.goal_prediction=false        # without the auxiliary goal
"""

from __future__ import annotations

from omegaconf import DictConfig, ListConfig
from tensordict.nn import TensorDictSequential

from torchgrasp.config import (
    DISTURBANCE,
    Run,
    check_exploration,
    conclude,
    gather_sources,
    make_demonstrator,
    make_expert,
    make_imitation_learner,
    one_line_errors,
    recipe_main,
    training_config,
)
from torchgrasp.errors import ConfigError
from torchgrasp.runs import seed_everything
from torchgrasp.training import ImitationLearner

ROLLOUTS = ("expert", "learner")


def train(cfg: DictConfig) -> dict:
    """Run the whole recipe, or the rest of the run that `resume` names; returns the summary."""
    cfg = training_config(cfg, "bc")
    check_rollouts(cfg)
    seed_everything(cfg.seed)
    with Run(cfg, make_imitation_learner(cfg)) as run:
        run.begin(gather_sources(cfg, run.pool, run.folder))
        pretrain(run)
        imitate(run)
        dagger = "learner" in cfg.online.rollouts and not cfg.offline.updates
        return conclude(run, phase="DAgger" if dagger else "more imitation")


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
    kind, reader = fresh_kind(cfg), f"online.rollouts={given}"
    if "expert" in given and kind in DISTURBANCE:
        check_exploration(cfg, DISTURBANCE[kind], reader, "or leave expert out of the rollouts")
    if "learner" in given:
        check_exploration(cfg, "expert_start", reader, "or leave learner out of the rollouts")


def fresh_kind(cfg: DictConfig) -> str:
    """How the expert acts in fresh episodes: disturbed, unless it was not in the demonstrations."""
    return "expert" if cfg.demonstrations.kind == "expert" else "perturbed"


def pretrain(run: Run[ImitationLearner]) -> None:
    """L_BC and L_AUX on D_expert alone (Sec. 3.3)."""
    for batch in run.pretraining():
        run.learner.imitate(batch)
    if run.cfg.pretrain.steps and run.progress < 1.0:
        run.measure_once("policy after imitation alone")


def imitate(run: Run[ImitationLearner]) -> None:
    """Episodes by the expert and the learner in turn (Sec. 3.3, 3.5), and L_BC and L_AUX on the mixture.

    Offline there are no episodes: the same updates on demonstrations alone.
    """
    rollouts = run.cfg.online.rollouts
    run.act(*make_actors(run))
    run.experience.draw_all(labelled=True)
    for iteration in run.iterations("more imitation"):
        learner_acts = bool(rollouts) and rollouts[iteration % len(rollouts)] == "learner"
        episodes = run.episodes()
        run.note_successes(episodes if learner_acts else ())
        for episode in episodes:
            if learner_acts or episode.success:  # D_expert holds successes alone (Sec. 6.4)
                run.experience.add(episode.steps)

        for batch in run.batches():
            run.learner.imitate(batch)


def make_actors(run: Run[ImitationLearner]) -> list[TensorDictSequential]:
    """Who acts in turn, as `online.rollouts` says; each state is labelled by the expert. Offline nobody."""
    cfg = run.cfg
    if cfg.offline.updates:
        return []
    labels = make_expert(cfg, "train", execute=False)  # first: an actor may read its goal
    modules: list = [labels, run.learner.actor, run.noise, run.expert_start]
    actors = {
        "expert": lambda: make_demonstrator(cfg, fresh_kind(cfg)),
        "learner": lambda: TensorDictSequential(*modules),
    }
    return [actors[name]() for name in cfg.online.rollouts]


@recipe_main(config_name="bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Train as configured."""
    train(cfg)


if __name__ == "__main__":
    main()
