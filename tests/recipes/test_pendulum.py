"""The pendulum's recipe, shortened."""

import math

import pendulum

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


def test_it_writes_its_table(run_recipe, tmp_path):
    code, out, err = run_recipe("pendulum", *SHORT, "seeds=[3]")
    assert code == 0, err
    assert out.splitlines()[0].split() == ["seed", "return", "before", "return", "after", "seconds"]
    assert list(tmp_path.glob("pendulum/*/pendulum.json"))
