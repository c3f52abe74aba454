"""The pendulum's recipe, shortened."""

import json
import math

import pytest

from recipes import pendulum
from torchgrasp.config import Pendulum, check_values
from torchgrasp.errors import ConfigError

SHORT = [
    "online_steps=4",
    "random_steps=6",
    "num_envs=4",
    "horizon=5",
    "batch_size=8",
    "evaluation_episodes=3",
]


def test_a_seed_fixes_the_result(composed):
    cfg = composed(*SHORT, recipe="pendulum")
    first, again, other = (pendulum.train(cfg, seed) for seed in (1, 1, 2))
    assert first["before"] == again["before"] and first["after"] == again["after"]
    assert first["after"] != other["after"]
    assert math.isfinite(first["after"]) and first["after"] < 0


def test_milestones_of_a_tiny_run_may_fall_together(composed):
    """0.7 and 0.9 of one step are both step 1."""
    cfg = composed(*SHORT, "online_steps=1", recipe="pendulum")
    assert math.isfinite(pendulum.train(cfg, 0)["after"])


@pytest.mark.parametrize(
    ("updates", "delay", "updated"), [(1, 2, True), (1, 4, True), (2, 3, True), (1, 5, False), (2, 9, False)]
)
def test_the_actors_delay_counts_critic_updates_over_the_run(composed, updates, delay, updated):
    """In four steps; an actor that is never updated acts as one that is never due."""
    runs = [*SHORT, f"updates={updates}"]
    found = pendulum.train(composed(*runs, f"policy_delay={delay}", recipe="pendulum"), 0)
    never = pendulum.train(composed(*runs, "policy_delay=1000", recipe="pendulum"), 0)
    assert (found["after"] != never["after"]) is updated


@pytest.mark.parametrize(
    "milestones", ["[0.9,0.7]", "[0.7,0.7]", "[0.7,1.5]", "[-0.1]", "[true]", "0.7", "null"]
)
def test_milestones_that_no_run_passes_in_order_are_refused(milestones, composed):
    with pytest.raises(ConfigError, match=r"^milestones=.*: give shares of the run from 0 to 1"):
        check_values(composed(f"milestones={milestones}", recipe="pendulum"), Pendulum)


def test_values_are_refused_before_the_table_begins(run_recipe, tmp_path):
    code, out, err = run_recipe("pendulum", *SHORT, "milestones=[0.9,0.7]")
    assert code == 1 and err.startswith("error: milestones=[0.9, 0.7]") and not out
    assert not (tmp_path / "pendulum").exists()


def test_one_seed_or_several_are_given(run_recipe, tmp_path):
    code, out, err = run_recipe("pendulum", *SHORT, "seeds=3")
    assert code == 0, err
    assert [line.split()[0] for line in out.splitlines()[:2]] == ["seed", "3"]
    assert out.splitlines()[0].split() == ["seed", "return", "before", "return", "after", "seconds"]
    (table,) = tmp_path.glob("pendulum/*/pendulum.json")
    assert set(json.loads(table.read_text())["rows"]) == {"3"}
