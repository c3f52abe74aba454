"""A trained policy goes on on objects without models: by a correction, or by hindsight goals (Sec. 6.1).

python recipes/hindsight.py init=outputs/td3_bc/<run>                          # the YCB objects
python recipes/hindsight.py init=outputs/td3_bc/<run> physics=low_friction
python recipes/hindsight.py init=outputs/td3_bc/<run> experiment=[paper,hindsight/normal]    # Algorithm 1

Nothing here knows an expert. By default a bounded correction of the policy learns of last actions that are
tried. In the paper's experiments episodes have no goal but where their own hand has grasped, and no label but
what they did themselves where it succeeded, with `online.self_imitation=true`.
"""

from __future__ import annotations

from omegaconf import DictConfig
from tensordict.nn import TensorDictSequential

from torchgrasp.config import (
    Run,
    begun_with,
    conclude,
    given_sources,
    make_actor_critic,
    one_line_errors,
    recipe_main,
    training_config,
)
from torchgrasp.modules.policy import join_policy
from torchgrasp.runs import seed_everything
from torchgrasp.training import ActorCriticLearner
from torchgrasp.transforms import HindsightGoal


def train(cfg: DictConfig) -> dict:
    """Run the whole recipe, or the rest of the run that `resume` names; returns the summary."""
    cfg = begun_with(training_config(cfg, "hindsight"))
    known = given_sources(cfg)
    seed_everything(cfg.seed)
    with Run(cfg, make_actor_critic(cfg), own="hindsight") as run:
        run.begin(known)
        run.measure_once("policy before fine-tuning")
        tune(run)
        return conclude(run, phase="fine-tuning")


def tune(run: Run[ActorCriticLearner]) -> None:
    """Algorithm 1 with D = D_expert of known objects and D_hindsight, by Eq. (5)."""
    cfg, learner, experience = run.cfg, run.learner, run.experience
    modules: list = [join_policy(learner.networks), run.tries, run.noise]
    run.act(TensorDictSequential(*(each for each in modules if each is not None)))
    relabel = HindsightGoal(imitate=cfg.online.self_imitation)
    experience.draw_all()
    if run.learned_nothing:
        learner.copy_to_targets()
    for iteration in run.iterations("fine-tuning"):
        episodes = run.episodes()
        run.note_successes(episodes)
        for episode in episodes:
            relabel(episode.steps)  # where it succeeded, the pose that it reached; on demand its actions too
            experience.add(episode.steps)

        for batch in run.batches():
            learner.update_critic(batch)
            experience.update_priorities(batch)
            if learner.actor_is_due and iteration >= cfg.online.critic_warmup:
                learner.update_actor(batch)


@recipe_main(config_name="hindsight")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Fine-tune as configured."""
    train(cfg)


if __name__ == "__main__":
    main()
