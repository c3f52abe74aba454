"""What a user may get wrong: one clear message, exit code 1, no traceback."""

import bc
import common
import hindsight
import pytest
import settings
import td3_bc
from learner import Learner

from torchgrasp.errors import ConfigError


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["demonstrations.kind=best"], "one of expert, perturbed, failed, learner"),
        (["demonstrations.count=none"], "one of all, successful, failed"),
        (["demonstrations.kind=failed", "demonstrations.count=successful"], "keeps nothing"),
        (["demonstrations.kind=learner"], "needs a policy"),
        (["demonstrations.kind=learner", "demonstrations.policy=no/such/run"], "no/such/run"),
        (["demonstrations.policy=some/run"], "no other kind takes one"),
        (["demonstrations.path=README.md"], "README.md is a file"),
        (["~transforms.table"], "+transforms.table={_target_: torchgrasp.transforms.TablePlane}"),
    ],
)
def test_impossible_demonstrations(run_recipe, overrides, told):
    code, _, err = run_recipe("collect", "experiment=smoke", *overrides)
    assert code == 1, err
    assert told in err and "Traceback" not in err
    assert sum(line.startswith("error:") for line in err.splitlines()) == 1


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["env.horizon=0"], "env.horizon=0"),
        (["transforms.aggregate.alpha=2"], "alpha=2"),
        (["objects=folder", "objects.path=no/such/folder"], "no/such/folder"),
        (["resume=no/such/run"], "no/such/run"),
        (["env.target_motion=jumping"], "jumping"),
        (["replay.online_fraction=1.5"], "1.5"),
        (["loss.bc_weight=-1"], "bc_weight"),
        (["model.state_inputs={wrist_angle: 2}"], "wrist_angle has the shape (1,)"),
        (["model.state_inputs={joints: 9}"], "replay.codec.state_keys"),
    ],
)
def test_impossible_values(run_recipe, overrides, told):
    code, _, err = run_recipe("td3_bc", "experiment=smoke", *overrides)
    assert code == 1, err
    assert told in err and "Traceback" not in err
    assert sum(line.startswith("error:") for line in err.splitlines()) == 1


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["demonstrations.steps=inf"], "demonstrations.steps=inf is no whole number"),
        (["collector.num_workers=1.5"], "collector.num_workers=1.5 is no whole number"),
        (["collector.num_workers=null"], "collector.num_workers=None is no whole number"),
        (["evaluation.episodes=true"], "evaluation.episodes=True is no whole number"),
        (["replay.online_capacity=0"], "replay.online_capacity=0 is out of range"),
        (["demonstrations.expert_start=maybe"], "demonstrations.expert_start=maybe is no switch"),
        (["model.table_input=maybe"], "model.table_input=maybe is no switch"),
        (["collector.disturb=null"], "collector.disturb=None .* demonstrations.kind=expert"),
        (["demonstrations.kind=failed", "collector.disturb_to_fail=3"], "collector.disturb_to_fail=3"),
        (["online.milestones=[0.7,0.4]"], r"online.milestones=\[0.7, 0.4\]: give shares of the run"),
        (["online.milestones=0.4"], "online.milestones=0.4: give shares of the run"),
        (["online.learning_rate=-1"], "online.learning_rate=-1 is out of range"),
        (["pretrain.learning_rate=fast"], "pretrain.learning_rate='fast' is no number"),
    ],
)
def test_values_of_another_type(composed, overrides, told):
    with pytest.raises(ConfigError, match=told):
        settings.check_values(composed(*overrides))


def test_what_is_not_needed_may_be_left_out(composed):
    settings.check_values(composed("demonstrations.kind=expert", "collector.disturb=null"))


def test_exploration_that_cannot_be_called_is_refused_before_a_run_begins(composed, tmp_path):
    for recipe in (td3_bc, bc):
        for name, told in (("noise", "with the same end switches it off"), ("expert_start", "probability=0")):
            cfg = composed("experiment=smoke", f"collector.{name}=null", recipe=recipe.__name__)
            with pytest.raises(ConfigError, match=f"collector.{name}=None with .*{told}"):
                recipe.train(cfg)
    with pytest.raises(ConfigError, match=r"collector\.noise=None with recipes/hindsight\.py"):
        hindsight.train(composed("experiment=smoke", "collector.noise=null", recipe="hindsight"))
    assert not list(tmp_path.iterdir())
    alone = ["online.rollouts=[expert]", "collector.expert_start=null"]
    bc.check_rollouts(composed("experiment=smoke", *alone, recipe="bc"))


def test_offline_nobody_acts_and_nobody_labels(composed):
    offline = composed("experiment=smoke", "offline.updates=3", "collector.expert_start=null")
    learner = Learner(offline, common.observed_shapes(offline))
    assert td3_bc.make_actors(offline, learner) == []


def test_a_wrong_norm_is_refused_before_anything_is_collected(composed, tmp_path):
    with pytest.raises(ConfigError, match="norm='l3' is unknown"):
        td3_bc.train(composed("experiment=smoke", "loss.distance.norm=l3"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", ["init", "demonstrations.policy"])
def test_a_directory_without_weights_is_told_from_none(composed, tmp_path, option):
    learner = ["demonstrations.kind=learner"] * (option != "init")
    for name, told in ((tmp_path, "holds no weights.safetensors"), (tmp_path / "nobody", "is not there")):
        with pytest.raises(ConfigError, match=told):
            settings.check_values(composed(f"{option}={name}", *learner))


def test_misspelt_override_gets_hydras_own_message(run_recipe):
    code, _, err = run_recipe("td3_bc", "experiment=smoke", "loss.bc_wieght=0.3")
    assert code == 1 and "bc_wieght" in err and "Traceback" not in err


def test_unreadable_mesh_is_named(run_recipe, tmp_path):
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "broken.obj").write_bytes(b"\x00\x01 this is no mesh")
    code, _, err = run_recipe("td3_bc", "experiment=smoke", "objects=folder", f"objects.path={meshes}")
    assert code == 1 and "broken.obj" in err and "Traceback" not in err


def test_unknown_policy_and_truncated_weights(run_recipe, tmp_path):
    code, _, err = run_recipe("evaluate", "policy=nobody", "episodes=1", "collector.num_workers=0")
    assert code == 1 and "nobody" in err and "Traceback" not in err
    (tmp_path / "weights.safetensors").write_bytes(b"half")
    code, _, err = run_recipe("evaluate", f"policy={tmp_path}/weights.safetensors", "episodes=1")
    assert code == 1 and "weights.safetensors" in err and "Traceback" not in err
