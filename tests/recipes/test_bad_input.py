"""What a user may get wrong: one clear message, exit code 1, no traceback; nothing is written."""

import pytest

from recipes import bc, hindsight, td3_bc
from torchgrasp.errors import ConfigError, ObjectError


@pytest.mark.parametrize(
    ("recipe", "overrides", "told"),
    [
        (
            "collect",
            ["demonstrations.kind=best"],
            "demonstrations.kind='best' is unknown: give one of expert",
        ),
        ("td3_bc", ["transforms.aggregate.alpha=2"], "transforms.aggregate.alpha=2 is out of range"),
        ("td3_bc", ["resume=no/such/run"], "resume=no/such/run is no run directory of td3_bc"),
    ],
)
def test_an_error_is_one_line(run_recipe, recipe, overrides, told):
    code, _, err = run_recipe(recipe, "experiment=smoke", *overrides)
    assert code == 1 and err.startswith(f"error: {told}") and err.count("\n") == 1


def test_misspelt_override_gets_hydras_own_message(run_recipe):
    code, _, err = run_recipe("td3_bc", "experiment=smoke", "loss.bc_wieght=0.3")
    assert code == 1 and "bc_wieght" in err and "Traceback" not in err


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["loss.distance.norm=l3"], "norm='l3' is unknown"),
        (["loss.bc_weight=-1"], r"^loss\.bc_weight=-1"),
        (["model.actor.freeze_encoder=true"], r"freeze_encoder=true would keep random weights.*init="),
        (["replay.online_capacity=1000000000000"], "transitions would fit"),
        (["replay=prioritised", "replay.priority.alpha=2"], r"^replay\.priority\.alpha=2"),
        (["model.actor.goal_input=maybe"], r"^model\.actor\.goal_input=maybe is no switch"),
        (["device=cuda:99"], "^device=cuda:99 cannot be used"),
        (["logger=mlflow", "online.decay=0"], r"^online\.decay=0 is out of range"),
        (["~transforms.table"], r"\+transforms\.table=\{_target_: torchgrasp\.transforms\.TablePlane\}"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(composed, tmp_path, overrides, told):
    with pytest.raises(ConfigError, match=told):
        td3_bc.train(composed("experiment=smoke", *overrides))
    assert not list(tmp_path.iterdir())


def test_exploration_that_cannot_be_called_is_refused_before_a_run_begins(composed, tmp_path):
    for recipe, name in ((td3_bc, "td3_bc"), (bc, "bc")):
        for option, told in (
            ("noise", "with the same end switches it off"),
            ("expert_start", "probability=0"),
        ):
            cfg = composed("experiment=smoke", f"collector.{option}=null", recipe=name)
            with pytest.raises(ConfigError, match=f"collector.{option}=None with .*{told}"):
                recipe.train(cfg)
    with pytest.raises(ConfigError, match=r"collector\.noise=None with the recipe hindsight"):
        hindsight.train(composed("experiment=smoke", "collector.noise=null", recipe="hindsight"))
    assert not list(tmp_path.iterdir())
    alone = ["online.rollouts=[expert]", "collector.expert_start=null"]
    bc.check_rollouts(composed("experiment=smoke", *alone, recipe="bc"))


def test_unreadable_mesh_is_named(composed, tmp_path):
    (tmp_path / "broken.obj").write_bytes(b"\x00\x01 this is no mesh")
    with pytest.raises(ObjectError, match=r"broken\.obj"):
        td3_bc.train(composed("experiment=smoke", "objects=folder", f"objects.path={tmp_path}"))
