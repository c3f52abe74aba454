"""Every plain value of a configuration by its type and range, refused by its place."""

import pytest

from tests.configurations import compose_config
from torchgrasp.config.schema import Comparison, Curves, Evaluate, Pendulum, Training
from torchgrasp.config.value_checks import check_values
from torchgrasp.errors import ConfigError


def composed(recipe: str, *overrides: str):
    return compose_config(*overrides, recipe=recipe)


@pytest.mark.parametrize("experiment", ["laptop", "demo", "paper", "smoke", "minutes"])
@pytest.mark.parametrize("recipe", ["td3_bc", "bc", "hindsight"])
def test_the_configurations_that_come_along_are_fine(recipe, experiment):
    check_values(composed(recipe, f"experiment={experiment}"), Training)


def test_those_of_the_other_recipes_too():
    check_values(composed("evaluate", "policy=expert"), Evaluate)
    check_values(composed("view", "policy=expert", "episodes=1"), Evaluate)
    check_values(composed("pendulum"), Pendulum)
    check_values(composed("pendulum", "seeds=3"), Pendulum)
    check_values(composed("compare", "runs=[a]"), Comparison)
    check_values(composed("curves", "runs={a: b}"), Curves)


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("demonstrations.steps=inf", "demonstrations.steps=inf is no whole number"),
        ("collector.num_workers=1.5", "collector.num_workers=1.5 is no whole number"),
        ("collector.num_workers=null", "collector.num_workers=None is no whole number"),
        ("evaluation.episodes=true", "evaluation.episodes=True is no whole number"),
        ("replay.online_capacity=0", "replay.online_capacity=0 is out of range"),
        ("replay.online_fraction=1.5", "replay.online_fraction=1.5 is out of range"),
        ("demonstrations.expert_start=maybe", "demonstrations.expert_start=maybe is no switch"),
        ("demonstrations.weight=-1", "demonstrations.weight=-1 is out of range"),
        ("model.table_input=maybe", "model.table_input=maybe is no switch"),
        ("model.critic.goal_input=3", "model.critic.goal_input=3 is no switch"),
        ("online.milestones=[0.7,0.4]", r"online.milestones=\[0.7, 0.4\]: give shares of the run"),
        ("online.milestones=0.4", "online.milestones=0.4: give shares of the run"),
        ("online.decay=0", r"online.decay=0 is out of range: give a value in \(0.0, 1.0\]"),
        ("online.learning_rate=-1", "online.learning_rate=-1 is out of range"),
        ("pretrain.learning_rate=fast", "pretrain.learning_rate='fast' is no number"),
        ("offline.updates=soon", "offline.updates=soon is no whole number"),
        ("demonstrations.weight=inf", "demonstrations.weight=inf is no finite number: give one"),
        ("env.physics.mass=inf", "env.physics.mass=inf is no finite number"),
        ("loss.aux_weight=-inf", "loss.aux_weight=-inf is no finite number"),
        ("expert.planner.budget=nan", "expert.planner.budget=nan is no finite number"),
        ("env.physics.mass=nan", "env.physics.mass=nan is no finite number"),
        ("device=toaster", "device=toaster cannot be used"),
        ("evaluation.baselines=[expert,oracle]", "evaluation.baselines.1='oracle' is unknown"),
        ("env.horizon=0", "env.horizon=0 is out of range"),
        ("env.horizon=1000000000", "env.horizon=1000000000 is out of range"),
        ("num_points=2000000000", "num_points=2000000000 is out of range"),
        ("seed=1e23", r"seed=1e\+23 is no whole number"),
        ("seed=99999999999", "seed=99999999999 is out of range"),
        ("device=meta", r"device=meta cannot be used \(known are cpu"),
        ("device=null", "device=None cannot be used"),
        ("checkpoint=null", "checkpoint=None is no section"),
        ("collector.pool=null", "collector.pool=None is no section"),
        ("replay.codec=null", "replay.codec=None: give a CompactTransitions"),
        (
            "transforms.sample._target_=no.such.Class",
            r"transforms\.sample\._target_=no\.such\.Class cannot be",
        ),
        ("transforms.sample=5", "transforms.sample=5: give a Transform"),
        ("trust=5", "trust=5 is no list"),
        ("trust=abc", "trust=abc is no list"),
        ("trust=[no_such_package]", r"trust=\['no_such_package'\]: no_such_package is no installed package"),
        ("+extra.nested=1", "extra={'nested': 1} is no option"),
        ("+online.extra=1", "online.extra=1 is no option"),
        ("output_dir=null", "output_dir=None is no path"),
        ("init=[a]", r"init=\['a'\] is no path"),
        ("replay.online_fraction=abc", "replay.online_fraction='abc' is no number"),
    ],
)
def test_impossible_values_are_refused_by_their_place(override, told):
    with pytest.raises(ConfigError, match=f"^{told}"):
        check_values(composed("td3_bc", override), Training)


def test_what_was_left_out_is_asked_for():
    with pytest.raises(ConfigError, match=r"^policy must be given, as policy=\.\.\."):
        check_values(composed("evaluate"), Evaluate)


def test_groups_that_do_not_go_together_are_told():
    told = r"^replay\.codec\.image_channels refers to what is not there .*'transforms\.image\.channels'"
    with pytest.raises(ConfigError, match=told):
        check_values(composed("td3_bc", "replay=images"), Training)


def test_a_configuration_that_lacks_a_section_is_refused():
    cfg = composed("td3_bc", "~checkpoint")
    with pytest.raises(ConfigError, match=r"^checkpoint is missing"):
        check_values(cfg, Training)
