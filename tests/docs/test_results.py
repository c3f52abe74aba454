"""Tables and figures of the pages are those of the files, every record tells its origin, tables run again."""

import json
import os
import re
import shutil
import subprocess
import sys

import pytest
from result_ages import find_behind, find_old
from result_history import find_commit
from result_pages import find_unbound, pages, render_page, render_table, shown_tables
from result_runs import read_success, run_table
from result_tables import (
    NOT_RECORDED,
    Record,
    find_row,
    read_table,
    show,
    shown_records,
    table_names,
    table_rows,
)

import torchgrasp
from tests.configurations import ROOT
from torchgrasp.errors import ConfigError

_FIGURE = re.compile(r"<!--fig\s(\S+?)(?:#\d+)?\s")
ORIGIN = {
    "command": "python recipes/evaluate.py policy=random episodes=2 objects.num_objects=2",
    "commit": "0123456",
    "machine": "two cores",
    "versions": {"torchgrasp": "0.1.0"},
    "recorded": "page",
}
SUCCESS = {"success_rate": 0.25, "success_ci95": [0.1, 0.5], "episodes": 12}
COLUMNS = [{"name": "policy", "cell": "{policy}"}, {"name": "success", "cell": "{success_rate:pct}"}]


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_show_what_the_files_hold(page):
    text = page.read_text()
    assert text == render_page(text), "python docs/results render writes it"
    assert find_unbound(text) == []


def test_every_record_is_shown():
    texts = [page.read_text() for page in pages()]
    shown = {place for text in texts for place in _FIGURE.findall(text)}
    for name in (name for text in texts for name in shown_tables(text)):
        shown |= shown_records(read_table(name)).keys()
    records = {f"{name}/{each}" for name in table_names() for each in read_table(name).records}
    assert records <= shown


@pytest.mark.parametrize("name", table_names())
def test_every_cell_of_a_table_can_be_filled(name):
    table = read_table(name)
    rows = table_rows(table)
    assert all(any(show(column.cell, row) for row in rows) for column in table.definition.columns)
    assert all(show(table.definition.columns[0].cell, row) for row in rows)


def test_counts_and_rates_of_a_record_agree():
    def check(row):
        if {"success_rate", "success_ci95", "episodes"} <= row.keys():
            successes = row["success_rate"] * row["episodes"]
            assert abs(successes - round(successes)) < 0.03 + 5e-5 * row["episodes"], row
            low, high = row["success_ci95"]
            assert low <= row["success_rate"] <= high, row
        for value in row.values():
            if isinstance(value, dict):
                check(value)

    records = [record for name in table_names() for record in read_table(name).records.values()]
    assert len(records) > 150
    for record in records:
        for row in record.rows:
            check(row)


def write(folder, name, definition, **records):
    (folder / name).mkdir()
    (folder / name / "table.json").write_text(json.dumps({"title": "It", "columns": COLUMNS, **definition}))
    for each, rows in records.items():
        (folder / name / f"{each}.json").write_text(json.dumps({**ORIGIN, "rows": rows}))


def test_a_template_is_filled_by_hand_computed_words():
    row = {"now": SUCCESS, "seeds": [0.5, 0.25], "seconds": 1.2345, "n": 1200}
    told = "{now.success_rate:pct}, {now.success_rate:pct0}, {now.success_ci95:to}, {now:success}"
    assert show(told, row) == "25.0 %, 25 %, 10.0 to 50.0, 25.0 % [10.0, 50.0]"
    assert show("{seeds:rates} mean {seeds:mean}; {seeds.1:rate}", row) == "50.0, 25.0 mean 37.5; 25.0"
    assert show("{seconds:ms} {seconds:ms1} {n:,}", row) == "1,234 1,234.5 1,200"
    assert show("{seconds:minutes}", {"seconds": 2160}) == "36"
    assert show("{nothing} %", row) == show("{now.seed}", row) == show("{seeds.7}", row) == ""


def test_rows_are_joined_by_key_and_taken_from_other_tables(tmp_path):
    write(
        tmp_path,
        "one",
        {"key": "policy", "records": ["a", "b"]},
        a=[{"policy": "x", "u": 1}],
        b=[{"policy": "x", "v": 2, "w": {"x": 1}}],
    )
    assert table_rows(read_table("one", tmp_path), tmp_path) == [
        {"policy": "x", "u": 1, "v": 2, "w": {"x": 1}}
    ]
    write(tmp_path, "two", {"rows": [{"*": "@one/a", "other": "@one/b#0.w", "goal": 3}]})
    (row,) = table_rows(read_table("two", tmp_path), tmp_path)
    assert row == {"policy": "x", "u": 1, "other": {"x": 1}, "goal": 3}
    assert list(shown_records(read_table("two", tmp_path), tmp_path)) == ["one/a", "one/b"]
    with pytest.raises(ConfigError, match="counted from 0"):
        find_row("one/a#1", tmp_path)


def test_a_page_gets_its_tables_and_figures(tmp_path):
    write(tmp_path, "one", {"records": ["a"]}, a=[{"policy": "x", **SUCCESS}])
    page = "It lifts <!--fig one/a {success_rate:pct}-->?<!--/-->.\n\n<!-- table one -->\n<!-- end -->\n"
    shown = render_page(page, tmp_path)
    assert "It lifts <!--fig one/a {success_rate:pct}-->25.0 %<!--/-->." in shown
    assert "\n| policy | success |\n|---|---|\n| x | 25.0 % |\n" in shown
    assert "Commit 0123456 (version 0.1.0); two cores." in shown
    assert render_page(shown, tmp_path) == shown
    for wrong, told in (
        ("<!--fig one/a {success_rate:pct}-->?<!--/-->", "begins a line"),
        ("a <!--fig one/a {none}-->?<!--/-->", "no value"),
        ("a <!--fig one/z {none}-->?<!--/-->", "no record"),
        ("<!-- table two -->\n<!-- end -->", "no table"),
        ("<!-- table one -->\n", "no whole marker"),
    ):
        with pytest.raises(ConfigError, match=told):
            render_page(wrong, tmp_path)


def test_measured_figures_outside_of_markers_are_found():
    measured = [
        "It lifts 97.5 % [91.3, 99.3].",
        "| box | **95.5 %** |",
        "| x | 1.5 to 2 ms | y |",
        "| 4 of 5 |",
    ]
    others = [
        "| holes of 0.5 % | closed |",
        "| `lr` | 0.3 |",
        "`[0.4, 0.7]`",
        "| `x` | `5 ms` |",
        "5 ms later",
    ]
    bound = "It lifts <!--fig one/a {rate}-->97.5 % [91.3, 99.3]<!--/--> of them."
    fenced = ["```text", "| 5 ms |", "```"]
    table = ["<!-- table one -->", "", "| 5 ms |", "", "<!-- end -->"]
    assert find_unbound("\n".join([*others, *measured, bound, *fenced, *table])) == measured


def test_notes_stand_below_a_table_with_the_records_that_they_are_of(tmp_path):
    rows = [{"policy": "x", **SUCCESS}]
    write(tmp_path, "one", {"records": ["a", "b"]}, a=rows, b=rows)
    write(tmp_path, "two", {"records": ["c"], "rows": [{"*": "@two/c"}, {"*": "@one/a"}]}, c=rows)
    for place, note in (("one/a", "old wrist; beside others; slow"), ("one/b", "old wrist"), ("two/c", "")):
        path = tmp_path / f"{place}.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), "note": note}))
    assert "two cores. Old wrist. `a`: beside others; slow.*" in render_table("one", tmp_path)
    told = " ".join(render_table("two", tmp_path).split())
    assert told.endswith("two cores. `one`: old wrist; beside others; slow.*")


def test_folders_and_records_that_do_not_belong_there_are_refused(tmp_path):
    write(tmp_path, "one", {"records": ["a", "b"]}, a=[{"policy": "x"}], c=[{"policy": "x"}])
    with pytest.raises(ConfigError, match="do not agree on the records b, c"):
        read_table("one", tmp_path)
    write(tmp_path, "two", {"records": ["a"]}, a=[])
    with pytest.raises(ConfigError, match=r"two/a\.json .*rows"):
        read_table("two", tmp_path)


def test_what_is_old_or_of_unknown_origin_is_told():
    record = Record(**ORIGIN, rows=[{}])
    assert find_old(record) == [f"version 0.1.0, the present one is {torchgrasp.__version__}"]
    fields = {**ORIGIN, "versions": {"torchgrasp": torchgrasp.__version__}}
    assert find_old(Record(**fields, rows=[{}])) == []
    unknown = {**fields, "commit_is": "recorded", "machine": NOT_RECORDED}
    assert find_old(Record(**unknown, rows=[{}])) == ["of 0123456 or before", "machine not recorded"]


def test_records_before_a_commit_or_the_last_change_of_a_path_are_told(tmp_path):
    git(tmp_path, "init", "-q")
    commits = []
    for name in ("sim.py", "docs.md", "sim.py", "other.py"):
        (tmp_path / name).write_text(str(len(commits)))
        commit_all(tmp_path)
        commits.append(git(tmp_path, "rev-parse", "--short", "HEAD"))
    assert find_commit("sim.py", tmp_path) == find_commit("HEAD~1", tmp_path) == commits[2]
    records = [Record(**{**ORIGIN, "commit": commit}, rows=[{}]) for commit in commits]
    told = [find_behind(record, commits[2], tmp_path) for record in records]
    assert told == [[f"of {commit}, which is without {commits[2]}"] for commit in commits[:2]] + [[], []]
    assert all(find_behind(record, root=tmp_path) == [] for record in records)
    unknown = Record(**ORIGIN, rows=[{}])
    assert find_behind(unknown, commits[2], tmp_path) == ["commit 0123456 is not in this history"]
    with pytest.raises(ConfigError, match="nothing is neither a commit nor a file or folder"):
        find_commit("nothing", tmp_path)
    (tmp_path / "new.py").write_text("")
    with pytest.raises(ConfigError, match=r"No commit holds new\.py"):
        find_commit("new.py", tmp_path)


def test_a_success_is_read_where_the_row_has_one():
    summary = {
        **SUCCESS,
        "failures": {"it fell": 9},
        "comparison": {"expert": {**SUCCESS, "success_rate": 1.0}},
    }
    assert read_success({"policy": "x", "success_rate": 0.9}, summary) == {
        "policy": "x",
        **SUCCESS,
        "failures": {"it fell": 9},
    }
    row = read_success({"run": {"success_rate": 0.9, "of": "expert"}}, summary)
    assert row == {"run": {"of": "expert", **SUCCESS, "success_rate": 1.0}}
    with pytest.raises(ConfigError, match="compares expert, not random"):
        read_success({"success_rate": 0.9, "of": "random"}, summary)
    with pytest.raises(ConfigError, match="no success of its own"):
        read_success({"policy": "x"}, summary)


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("rm -rf x", "no command of a recipe"),
        ("python recipes/../../x.py", "no command of a recipe"),
        ("python recipes/evaluate.py policy=<run>", "needs a run"),
        (NOT_RECORDED, "no command of a recipe"),
    ],
)
def test_only_commands_of_recipes_and_benchmarks_are_run(tmp_path, command, told):
    write(tmp_path, "one", {"records": ["a"], "reads": "summary"})
    (tmp_path / "one" / "a.json").write_text(json.dumps({**ORIGIN, "command": command, "rows": [SUCCESS]}))
    with pytest.raises(ConfigError, match=told):
        run_table("one", folder=tmp_path)


def test_a_table_that_is_no_plain_output_names_its_commands(tmp_path):
    write(tmp_path, "one", {"records": ["a"]}, a=[SUCCESS])
    with pytest.raises(ConfigError, match="these gave it:\npython recipes/evaluate"):
        run_table("one", folder=tmp_path)


@pytest.fixture
def checkout(tmp_path):
    """A repository of its own with one small table, committed."""
    for folder in ("torchgrasp", "conf", "recipes", "docs/results"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for table in (path.parent for path in (tmp_path / "docs" / "results").glob("*/table.json")):
        shutil.rmtree(table)
    rows = [{"policy": "random", "success_rate": 1.0}]
    write(tmp_path / "docs" / "results", "one", {"records": ["a", "b"], "reads": "summary"}, a=rows, b=rows)
    path = tmp_path / "docs" / "results" / "one" / "a.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "note": "by chance", "needs": ["make"]}))
    (tmp_path / "README.md").write_text("<!-- table one -->\n<!-- end -->\n")
    git(tmp_path, "init", "-q")
    (tmp_path / ".gitignore").write_text("__pycache__/\n")
    commit_all(tmp_path)
    return tmp_path


def git(folder, *words):
    done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def commit_all(folder):
    git(folder, "add", ".")
    git(folder, "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-q", "-m", "All")


def command(folder, *words):
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    script = [sys.executable, "docs/results", *words]
    done = subprocess.run(script, cwd=folder, env=environment, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
def test_a_table_is_run_again_and_goes_on_where_it_was(checkout):
    code, told = command(checkout, "run", "one", "--only", "a")
    assert code == 0, told
    record = json.loads((checkout / "docs" / "results" / "one" / "a.json").read_text())
    assert record["commit"] == git(checkout, "rev-parse", "--short", "HEAD")
    assert record["recorded"] == "run" and record["versions"]["torchgrasp"] == torchgrasp.__version__
    assert record["note"] == "by chance" and record["needs"] == ["make"]
    assert "one/a keeps its note, see whether it still holds: by chance" in told
    assert record["rows"][0]["episodes"] == 2 and record["rows"][0]["policy"] == "random"
    commit_all(checkout)
    code, told = command(checkout, "run", "one")  # another commit of the same code
    assert code == 0 and "one/a: of this version's code already" in told
    assert told.count("python recipes/evaluate.py") == 1
    assert json.loads((checkout / "docs" / "results" / "one" / "b.json").read_text())["recorded"] == "run"
    assert "| random | 0.0 % |" in (checkout / "README.md").read_text()
    (checkout / "recipes" / "evaluate.py").write_text("")
    code, told = command(checkout, "run", "one")
    assert code == 1 and "commit these first, or undo them: M recipes/evaluate.py" in told
