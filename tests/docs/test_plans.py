"""Tables of runs over seeds: what is declared once is run, gathered over seeds and compared."""

import json
import signal
import subprocess
import sys
import time

import pytest
from result_differences import tell_order
from result_pages import render_table
from result_plan_runs import choose_records, list_tasks, read_rows, run_plan
from result_plans import Plan, find_commands
from result_tables import find_row, read_table, shown_records, table_rows

from tests.docs.test_results import COLUMNS, ORIGIN, checkout, command, commit_all, git, write  # noqa: F401
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.intervals import mean_interval, newcombe_interval, paired_interval

COLLECT = "python recipes/collect.py experiment=smoke demonstrations.path=<demos>"
TRAIN = "python recipes/bc.py experiment=smoke total_env_steps=0 demonstrations.path=<demos>"
TEST = "python recipes/evaluate.py policy=<taught> episodes=2 evaluation.num_envs=1"
RUNS = {
    "taught": {
        "command": TRAIN,
        "decides": "whether it goes on",
        "rows": [{"cell": "taught", "published": [0.75, None]}, {"cell": "the expert", "of": "expert"}],
    },
    "tested": {"command": TEST, "decides": "the same", "rows": [{"cell": "again"}]},
}
PLAN = {"seeds": [0, 1, 2], "folders": {"demos": COLLECT}, "runs": RUNS}


def record(rate, outcomes="", **fields):
    row = {"success_rate": rate, "success_ci95": [0.0, 1.0], "episodes": 4}
    return {**ORIGIN, **fields, "rows": [{**row, "outcomes": outcomes} if outcomes else row]}


def write_plan(folder, **records):
    columns = [{"name": "cell", "cell": "{cell}"}, {"name": "rates", "cell": "{success_rate:rates}"}]
    write(folder, "one", {"columns": columns, "plan": PLAN, "reads": "summary"})
    for name, value in records.items():
        (folder / "one" / f"{name}.json").write_text(json.dumps(value))


def write_pairs(folder, **pair):
    pairs = {"table": "one", "pairs": [{"order": "more", "better": "tested", "worse": "taught", **pair}]}
    write(folder, "two", {"compares": pairs})
    (row,) = table_rows(read_table("two", folder), folder)
    return row


def test_rows_gather_the_seeds_of_a_run_and_lack_what_was_not_run(tmp_path):
    write_plan(tmp_path, taught_0=record(0.25), taught_2=record(0.75))
    taught, expert, again = table_rows(read_table("one", tmp_path))
    assert (taught["seeds"], taught["success_rate"], taught["version"]) == ([0, 2], [0.25, 0.75], "0.1.0")
    assert expert == {"cell": "the expert", "of": "expert"} and again == {"cell": "again"}
    assert "| taught | 25.0, 75.0 |\n| the expert | |\n| again | |" in render_table("one", tmp_path)
    assert find_row("one/taught", tmp_path) == taught
    with pytest.raises(ConfigError, match="tested#1 is no row of a run"):
        find_row("one/tested#1", tmp_path)
    write(tmp_path, "other", {"columns": COLUMNS, "rows": [{"*": "@one/taught"}]})
    assert list(shown_records(read_table("other", tmp_path), tmp_path)) == ["one/taught_0", "one/taught_2"]


def test_what_was_run_replaces_what_a_page_told(tmp_path):
    write_plan(tmp_path, taught_0=record(0.25), taught_1=record(0.75, recorded="run"))
    table = read_table("one", tmp_path)
    assert table_rows(table)[0]["seeds"] == [1]
    assert list(shown_records(table, tmp_path)) == ["one/taught_1"]


def test_records_of_no_run_or_seed_are_refused(tmp_path):
    write_plan(tmp_path, taught_3=record(0.25))
    with pytest.raises(ConfigError, match="do not agree on the records taught_3"):
        read_table("one", tmp_path)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"runs": {"tested": RUNS["tested"], "taught": RUNS["taught"]}}, "no run before it"),
        ({"folders": {}}, "tested needs <demos>|taught needs <demos>"),
        ({"folders": {"demos": "python recipes/collect.py"}}, "has to name <demos>"),
        ({"folders": {"taught": COLLECT}}, "names a folder and a run"),
    ],
)
def test_plans_whose_names_stand_for_nothing_are_refused(changed, told):
    with pytest.raises(ValueError, match=told):
        Plan.model_validate({**PLAN, **changed})


def test_differences_are_those_of_the_librarys_statistics(tmp_path):
    rates = {"taught": (0.25, 0.5, 0.5), "tested": (0.75, 0.75, 0.5)}
    write_plan(
        tmp_path, **{f"{run}_{seed}": record(each[seed]) for run, each in rates.items() for seed in (0, 1, 2)}
    )
    row = write_pairs(tmp_path)
    assert row["points"] == pytest.approx(25.0) and row["method"] == "Newcombe"
    assert row["over_seeds"] == pytest.approx([100 * end for end in mean_interval([0.5, 0.25, 0.0])])
    assert row["over_episodes"] == pytest.approx([100 * end for end in newcombe_interval(8, 12, 5, 12)])
    assert row["here"] == "not told apart" and "published" not in row


def test_differences_are_paired_by_scene_where_outcomes_are_known(tmp_path):
    outcomes = {"taught": ("1000", "0000"), "tested": ("1100", "1110")}
    rates = {
        f"{run}_{seed}": record(told.count("1") / 4, told, seed=seed)
        for run, each in outcomes.items()
        for seed, told in enumerate(each)
    }
    write_plan(tmp_path, **rates)
    row = write_pairs(tmp_path, published=["taught", "taught"])
    assert row["method"] == "paired"
    assert row["over_episodes"] == pytest.approx([100 * end for end in paired_interval(4, 0, 8)])
    assert row["published"] == [0.0, None]


def test_rows_of_different_versions_are_not_compared(tmp_path):
    old = {f"taught_{seed}": record(0.25) for seed in (0, 1, 2)}
    new = {f"tested_{seed}": record(0.75, versions={"torchgrasp": "0.2.0"}) for seed in (0, 1, 2)}
    write_plan(tmp_path, **old, **new)
    assert write_pairs(tmp_path) == {"order": "more"}


def test_an_order_is_told_from_both_intervals():
    assert tell_order([(1.0, 3.0), (-1.0, 4.0)]) == "holds by one interval of two"
    assert tell_order([(-3.0, -1.0), (-4.0, 4.0)]) == "the other way round by one interval of two"


def test_what_a_run_needs_is_run_before_it_once(tmp_path):
    plan = Plan.model_validate(PLAN)
    tasks = list_tasks(plan, choose_records(plan, ["tested_1", "taught"]), tmp_path)
    assert list(tasks) == ["demos", "taught_0", "taught_1", "taught_2", "tested_1"]
    assert tasks["taught_1"].needs == ("demos",) and tasks["tested_1"].needs == ("taught_1",)
    (tmp_path / "taught_1").mkdir()
    (tmp_path / "taught_1" / "summary.json").write_text("")  # it is kept, and not asked for
    (tmp_path / "taught_1.commands").write_text(f"{COLLECT}\n{TRAIN} seed=1")
    assert list(list_tasks(plan, ["tested_1"], tmp_path)) == ["tested_1"]
    (tmp_path / "taught_1.commands").write_text(f"{COLLECT} seed=9\n{TRAIN} seed=1")  # of an earlier plan
    assert list(list_tasks(plan, ["tested_1"], tmp_path)) == ["demos", "taught_1", "tested_1"]
    assert find_commands(plan, "tested", 1) == [COLLECT, f"{TRAIN} seed=1"]
    with pytest.raises(ConfigError, match="one is no run: choose from taught, tested"):
        choose_records(plan, ["one"])


def test_rows_of_a_summary_have_their_table_and_their_predictions():
    table = {"success_rate": 0.5, "success_ci95": [0.1, 0.9], "episodes": 2, "outcomes": "10"}
    errors = {"actor": {"expert_goal": {"translation_m": {"min": 0.1, "mean": 0.2}}, "trajectories": 2}}
    summary = {**table, "wall_seconds": 3.0, "grasp_prediction": errors}
    summary["comparison"] = {"expert": {**table, "success_rate": 1.0, "outcomes": "11"}}
    labels = [{"cell": "x", "predictor": "actor"}, {"cell": "y", "of": "expert"}]
    planned = Plan.model_validate(PLAN).runs["tested"].model_copy(update={"rows": labels})
    first, second = read_rows(planned, summary)
    assert first == {**table, "wall_seconds": 3.0, "grasp_prediction": errors["actor"]["expert_goal"]}
    assert second == {**table, "success_rate": 1.0, "outcomes": "11", "wall_seconds": 3.0}
    planned = planned.model_copy(update={"rows": [{"cell": "x", "predictor": "critic"}]})
    with pytest.raises(ConfigError, match="predictions of actor, not of critic"):
        read_rows(planned, summary)


def test_a_number_of_jobs_is_one_at_least(tmp_path):
    write_plan(tmp_path)
    with pytest.raises(ConfigError, match="--jobs 0: give 1"):
        run_plan("one", jobs=0, folder=tmp_path)


@pytest.fixture
def planned(checkout):  # noqa: F811
    """The checkout with a small plan in place of its table."""
    results = checkout / "docs" / "results"
    for path in (results / "one").iterdir():
        path.unlink()
    (results / "one").rmdir()
    write_plan(results)
    (checkout / ".gitignore").write_text("__pycache__/\noutputs/\n")
    commit_all(checkout)
    return checkout


@pytest.mark.slow
def test_a_plan_is_run_stopped_and_continued(planned):
    results = planned / "docs" / "results" / "one"
    words = ["run", "one", "--only", "taught_0", "taught_1", "tested_0", "--jobs", "2"]
    script = [sys.executable, "docs/results", *words]
    environment = {"PYTHONPATH": str(planned), "PATH": "/usr/bin:/bin"}
    with subprocess.Popen(script, cwd=planned, env=environment, stdout=subprocess.PIPE, text=True) as stopped:
        assert stopped.stdout is not None
        for line in stopped.stdout:
            if "taught_0 begins" in line:
                break
        time.sleep(1.0)
        stopped.send_signal(signal.SIGTERM)
        assert stopped.wait() == 143
    assert not (results / "tested_0.json").exists()
    code, told = command(planned, *words)
    assert code == 0, told
    found = json.loads((results / "tested_0.json").read_text())
    assert found["seed"] == 0 and found["needs"] == [COLLECT, f"{TRAIN} seed=0"]
    assert found["commit"] == git(planned, "rev-parse", "--short", "HEAD")
    assert found["note"] == "2 runs side by side, one thread each"
    assert len(json.loads((results / "taught_1.json").read_text())["rows"]) == 2
    assert not (results / "taught_2.json").exists()
    assert "| taught | " in (planned / "README.md").read_text()
    commit_all(planned)
    code, told = command(planned, *words)
    assert code == 0 and "one: 3 of 3 records are there already" in told and "begins" not in told


@pytest.mark.slow
def test_a_run_that_fails_is_named_and_leaves_the_others_alone(planned):
    path = planned / "docs" / "results" / "one" / "table.json"
    definition = json.loads(path.read_text())
    definition["plan"]["runs"]["taught"]["command"] += " total_env_steps=-1"
    chance = "python recipes/evaluate.py policy=random episodes=2 objects.num_objects=2"
    definition["plan"]["runs"]["chance"] = {**RUNS["tested"], "command": chance}
    path.write_text(json.dumps(definition))
    commit_all(planned)
    code, told = command(planned, "run", "one", "--only", "tested_0", "chance_0")
    assert code == 1
    assert "tested_0 (needs taught_0)" in told and "taught_0 (exit code 1: see " in told
    assert (path.parent / "chance_0.json").exists() and not (path.parent / "tested_0.json").exists()
