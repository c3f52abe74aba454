"""What fine-tuning takes over from the run that it begins with."""

import shutil

import pytest

from torchgrasp.config import begun_with
from torchgrasp.errors import ConfigError

TUNED = ["experiment=[smoke,hindsight/normal]"]
BROUGHT = ["env.horizon=8", "num_points=48", "model.width=0.5", "replay.augment=null"]


@pytest.fixture
def init(untrained, demonstrations):
    """Weights with the demonstrations that they learned from beside them."""
    path = untrained(*BROUGHT)
    shutil.copytree(demonstrations, path.parent / "demonstrations")
    return path.parent


def test_networks_observations_task_and_demonstrations_are_the_first_runs(composed, init):
    cfg = composed(*TUNED, f"init={init}", "objects=procedural", "online.updates=9", recipe="hindsight")
    begun = begun_with(cfg)
    assert (begun.env.horizon, begun.num_points, begun.model.width) == (8, 48, 0.5)
    assert (
        begun.demonstrations.path == str(init / "demonstrations") and begun.demonstrations.kind == "perturbed"
    )
    # The rest is the fine-tuning's own, frozen encoders too.
    assert begun.online.updates == 9 and begun.loss.hindsight is True
    assert begun.model.actor.freeze_encoder and begun.model.critic.freeze_encoder


def test_encoders_may_be_left_to_learn(composed, init):
    cfg = composed(*TUNED, f"init={init}", "model.critic.freeze_encoder=false", recipe="hindsight")
    begun = begun_with(cfg)
    assert begun.model.actor.freeze_encoder and not begun.model.critic.freeze_encoder


def test_demonstrations_may_be_given(composed, untrained, demonstrations):
    given = [f"init={untrained()}", f"demonstrations.path={demonstrations}"]
    assert begun_with(composed(*TUNED, *given, recipe="hindsight")).demonstrations.path == str(demonstrations)


@pytest.mark.parametrize("given", ["num_points=64", "transforms.aggregate.alpha=0.9", "model.width=1"])
def test_what_the_first_run_brings_along_is_not_given_anew(on_command_line, init, given):
    cfg = on_command_line(*TUNED, f"init={init}", given, recipe="hindsight")
    with pytest.raises(ConfigError, match=f"brings model, .* along: leave out {given.split('=')[0]}"):
        begun_with(cfg)


def test_a_run_that_is_resumed_has_it_already(composed, tmp_path):
    cfg = composed(*TUNED, f"resume={tmp_path}", recipe="hindsight")
    assert begun_with(cfg) is cfg


def test_what_cannot_be_fine_tuned_is_refused(composed, untrained):
    with pytest.raises(ConfigError, match="init is missing"):
        begun_with(composed(*TUNED, recipe="hindsight"))
    with pytest.raises(ConfigError, match="leaves no episodes"):
        begun_with(composed(*TUNED, "init=pretrained", "offline.updates=3", recipe="hindsight"))
    with pytest.raises(ConfigError, match=r"has no demonstrations beside it.*demonstrations\.path="):
        begun_with(composed(*TUNED, f"init={untrained()}", recipe="hindsight"))


def test_without_a_residual_a_critic_stays_as_it_was_trained(composed, untrained, demonstrations):
    path = untrained(*BROUGHT, "model.critic.norm=layer", "model.critic.goal_prediction=false")
    shutil.copytree(demonstrations, path.parent / "demonstrations")
    begun = begun_with(composed(*TUNED, f"init={path.parent}", recipe="hindsight"))
    assert begun.model.critic.norm == "layer" and begun.model.critic.goal_prediction is False


def test_an_actor_that_reads_goals_gets_no_residual(composed, untrained):
    given = ["experiment=[smoke,residual,hindsight/normal]", "replay.online_fraction=1.0"]
    init = untrained(*BROUGHT, "model.actor.goal_input=true")
    with pytest.raises(ConfigError, match=r"model\.actor\.goal_input=true with model\.residual"):
        begun_with(composed(*given, f"init={init}", recipe="hindsight"))
