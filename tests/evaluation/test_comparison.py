import json
import math
from dataclasses import asdict

import pytest
import yaml

from tests.run_files import compare_four_groups, read_runs, success_table, write_run
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.evaluation.comparison import compare_runs
from torchgrasp.evaluation.run_results import check_same_scenes, read_result, read_scenes
from torchgrasp.sim import MujocoEngine


@pytest.fixture
def rows(tmp_path):
    return compare_four_groups(tmp_path)


def test_three_seeds_by_hand(rows):
    first, second = rows[:2]
    assert first.seeds == (0, 1, 2) and first.values == (0.3, 0.4, 0.5)
    assert first.mean == pytest.approx(0.4) and first.std == pytest.approx(0.1)
    assert first.success == (12, 30) and first.pooled is not None
    assert first.pooled == pytest.approx((0.4, 0.2459, 0.5768), abs=1e-4)  # Wilson's interval of 12 in 30
    assert first.difference is None
    assert second.seeds == (0, 1, 2) and second.values == (0.5, 0.8, 0.8)  # sorted by seed


def test_differences_are_paired_by_seed_where_they_can_be(rows):
    _, paired, welch, alone = (row.difference for row in rows)
    # Per seed 0.2, 0.4, 0.3: mean 0.3, s = 0.1, t(0.975, 2) = 4.302653.
    assert (paired.method, paired.value) == ("paired", pytest.approx(0.3))
    assert paired.over_seeds == pytest.approx((0.3 - 0.248414, 0.3 + 0.248414), abs=1e-6)
    assert (welch.method, welch.value) == ("welch", pytest.approx(0.3))
    assert welch.over_seeds[0] < 0.3 < welch.over_seeds[1]
    assert (alone.method, alone.over_seeds, alone.value) == (None, None, pytest.approx(0.6))
    assert all(each.over_episodes is not None for each in (paired, welch, alone))


def test_another_table_of_the_summary(tmp_path):
    prediction = {"actor": {"trajectories": 7, "expert_goal": {"translation_m": {"min": 0.02, "mean": 0.05}}}}
    comparison = {"policy": success_table(8), "expert": success_table(10)}
    run = write_run(tmp_path / "run", 0, 8, comparison=comparison, grasp_prediction=prediction)
    assert read_result(run, key="expert").success == (10, 10)
    found = read_result(run, key="grasp_prediction")
    assert found.success is None
    assert found.values == {
        "actor expert goal translation m min": 0.02,
        "actor expert goal translation m mean": 0.05,
    }
    with pytest.raises(ConfigError, match=r"key=planner: .* choose from grasp_prediction, policy, expert"):
        read_result(run, key="planner")


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("evaluation", "seed", 7),
        ("evaluation", "episodes", 20),
        ("evaluation", "split", "val"),
        ("evaluation", "num_objects", 3),
        ("evaluation", "num_envs", 2),
        ("objects", "_target_", "torchgrasp.objects.YcbObjects"),
        ("env", "target_motion", "jitter"),
        ("env", "horizon", 20),
    ],
)
def test_other_scenes_are_refused_by_name(tmp_path, part, name, value):
    ours = read_result(write_run(tmp_path / "ours", 0, 5))
    other = read_result(write_run(tmp_path / "other", 0, 5, config={part: {name: value}}))
    with pytest.raises(
        ConfigError, match=rf"ours and .*other were evaluated on different.*{name}=.* {value}"
    ):
        check_same_scenes([ours, ours, other])


def test_targets_move_as_the_evaluation_says(tmp_path):
    """Where `evaluation.target_motion` is given, it holds; else the environment's own."""
    motions = {"still": (None, "static"), "told": ("jitter", "static"), "own": (None, "jitter")}
    still, told, own = (
        read_result(
            write_run(
                tmp_path / name,
                0,
                5,
                config={"evaluation": {"target_motion": motion}, "env": {"target_motion": trained}},
            )
        )
        for name, (motion, trained) in motions.items()
    )
    check_same_scenes([told, own])
    with pytest.raises(ConfigError, match=r"env.target_motion=static and jitter"):
        check_same_scenes([still, told])


def test_engines_are_compared_by_what_they_do(tmp_path):
    """Not by how much of them is written out, nor by how a pair is."""
    names = ("torchgrasp.sim.MujocoEngine", "torchgrasp.sim.mujoco.mujoco_engine.MujocoEngine")
    engines = [
        {"_target_": names[0]},
        {"_target_": names[1], **asdict(MujocoEngine())},
        {"_target_": names[0], "impedance": [0.95, 0.99], "substeps": 8},
        {"_target_": names[0], "substeps": 3},
        {"_target_": "torchgrasp.sim.SapienEngine"},
    ]
    scenes = [read_scenes({"engine": each}) for each in (*engines, None)]
    assert scenes[0] == scenes[1] == scenes[2] and scenes[4] == scenes[5] == read_scenes({})
    runs = [
        read_result(write_run(tmp_path / str(seed), seed, 5, config={"engine": each}))
        for seed, each in enumerate(engines[2:4])
    ]
    with pytest.raises(ConfigError, match=r"\(engine.substeps=8 and 3\)"):
        check_same_scenes(runs)


def test_an_engine_of_one_s_own_is_compared_as_it_is_told():
    own = {"_target_": "mine.MujocoEngine"}
    assert read_scenes({"engine": own}) == {**read_scenes({}), "engine._target_": "mine.MujocoEngine"}
    assert read_scenes({"engine": own}) != read_scenes({"engine": {**own, "substeps": 8}})


def test_what_training_alone_sees_may_differ(tmp_path):
    trained_otherwise = {"objects": {"num_objects": 1500, "num_grasps": 50}, "env": {"num_envs": 1}}
    check_same_scenes(
        [
            read_result(write_run(tmp_path / "ours", 0, 5)),
            read_result(write_run(tmp_path / "other", 1, 5, config=trained_otherwise)),
        ]
    )


def test_other_objects_under_the_same_options_are_noticed(tmp_path):
    summary = success_table(5)
    summary["objects"]["cup"] = summary["objects"].pop("mug")
    runs = [
        read_result(write_run(tmp_path / "ours", 0, 5)),
        read_result(write_run(tmp_path / "b", 1, 5, **summary)),
    ]
    with pytest.raises(ConfigError, match="episodes of mug=5 and -; episodes of cup=- and 5"):
        check_same_scenes(runs)


def test_an_evaluation_has_the_seed_of_what_it_evaluated(tmp_path):
    trained = write_run(tmp_path / "trained", 4, 5)
    evaluation = write_run(tmp_path / "evaluation", 1000, 6)
    config = yaml.safe_load((evaluation / "config.yaml").read_text())
    for policy, seed in ((str(trained), 4), ("expert", None), (str(tmp_path / "gone"), None)):
        (evaluation / "config.yaml").write_text(yaml.safe_dump({**config, "policy": policy, "learner": None}))
        assert read_result(evaluation).seed == seed


def test_a_seed_twice_or_none_finished_is_refused(tmp_path):
    one = read_runs(tmp_path / "a", {0: 3}) + read_runs(tmp_path / "b", {0: 3})
    with pytest.raises(ConfigError, match="have the same seed 0"):
        compare_runs({"twice": one})
    with pytest.raises(ConfigError, match="empty: no run has finished"):
        compare_runs({"empty": []})


def test_damaged_and_diverged_runs_are_named(tmp_path):
    run = write_run(tmp_path / "run", 0, 5, grasp_prediction={"actor": {"rotation_deg": math.nan}})
    with pytest.raises(ConfigError, match="actor rotation deg holds no number: leave the run out"):
        read_result(run, key="grasp_prediction")
    (run / "summary.json").write_text(json.dumps({**success_table(5), "wall_seconds": 1.0, "env_steps": 3}))
    with pytest.raises(CheckpointError, match="gradient_steps"):
        read_result(run)
    other = write_run(tmp_path / "other", 0, 5)
    (other / "config.yaml").unlink()
    with pytest.raises(CheckpointError, match=r"config\.yaml is missing"):
        read_result(other)
