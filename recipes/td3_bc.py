"""Goal-auxiliary actor-critic: demonstrations, imitation, reinforcement with DAgger labels, the proof.

python recipes/td3_bc.py                         # a quarter of an hour on two cores
python recipes/td3_bc.py experiment=paper        # Sec. 6.4 to the letter
python recipes/td3_bc.py offline.updates=5000    # from demonstrations alone
python recipes/td3_bc.py resume=outputs/td3_bc/<date_time>
"""

from __future__ import annotations

from omegaconf import DictConfig
from tensordict.nn import TensorDictSequential

from torchgrasp.config import (
    Run,
    check_exploration,
    conclude,
    find_successor,
    gather_sources,
    make_expert,
    make_first_learner,
    one_line_errors,
    recipe_main,
    training_config,
)
from torchgrasp.data.demonstration_sources import without_expert
from torchgrasp.modules.goal_keys import reads_goal
from torchgrasp.runs import seed_everything
from torchgrasp.training import ActorCriticLearner


def train(cfg: DictConfig) -> dict:
    """Run the whole recipe, or the rest of the run that `resume` names; returns the summary."""
    cfg = training_config(cfg, "td3_bc")
    if not cfg.offline.updates and cfg.online.dagger:
        check_exploration(cfg, "expert_start", "the learner's episodes")
    seed_everything(cfg.seed)
    with Run(cfg, make_first_learner(cfg), successor=find_successor(cfg)) as run:
        run.begin(gather_sources(cfg, run.pool, run.folder))
        pretrain(run)
        reinforce(run)
        return conclude(run, phase="reinforcement")


def pretrain(run: Run[ActorCriticLearner]) -> None:
    """L_BC and L_AUX on D_expert alone (Sec. 3.3); on demand the critic learns meanwhile."""
    for batch in run.pretraining():
        run.learner.imitate(batch)
        if run.cfg.pretrain.critic:
            run.learner.update_critic(batch)
            run.experience.update_priorities(batch)
    began, taught = run.learned_nothing and run.progress < 1.0, bool(run.cfg.pretrain.steps)
    if began and (taught or run.cfg.init is not None):
        run.measure_once("policy after imitation alone" if taught else "policy before reinforcement")


def reinforce(run: Run[ActorCriticLearner]) -> None:
    """Rollouts of the learner, labelled by the expert, and TD3+BC on the mixture (Sec. 3.4, 3.5, 6.4).

    Offline there are no rollouts: the same updates on demonstrations alone.
    """
    run.succeed()
    cfg, learner, experience = run.cfg, run.learner, run.experience
    run.act(*make_actors(run))
    experience.draw_all()
    if run.learned_nothing and run.progress < 1.0:
        learner.copy_to_targets()
    for iteration in run.iterations("reinforcement"):
        episodes = run.episodes()
        run.note_successes(episodes)
        for episode in episodes:
            experience.add(episode.steps if cfg.online.dagger else without_expert(episode.steps))

        for batch in run.batches():
            learner.update_critic(batch)  # Eq. (3), and the targets
            experience.update_priorities(batch)
            if learner.actor_is_due and iteration >= cfg.online.critic_warmup:
                learner.update_actor(batch)  # Eq. (4)


def make_actors(run: Run[ActorCriticLearner]) -> list[TensorDictSequential]:
    """The learner, whose states the expert labels where they, or goals, are learned from; offline nobody."""
    cfg, learner = run.cfg, run.learner
    if cfg.offline.updates:
        return []
    modules: list = [learner.actor, run.tries, run.noise, run.expert_start]
    reading = any(map(reads_goal, learner.networks.values()))
    if cfg.online.dagger or run.expert_start is not None or reading:
        modules.insert(0, make_expert(cfg, "train", execute=False))  # first: an actor may read its goal
    return [TensorDictSequential(*(each for each in modules if each is not None))]


@recipe_main(config_name="td3_bc")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Train as configured."""
    train(cfg)


if __name__ == "__main__":
    main()
