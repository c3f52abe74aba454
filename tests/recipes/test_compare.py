"""recipes/compare.py: groups of runs side by side."""

import pytest

from recipes import compare
from tests.run_files import write_run
from torchgrasp.errors import ConfigError
from torchgrasp.runs.sweep_record import SweepJob, write_job


@pytest.fixture
def runs(tmp_path):
    """Two finished runs of each kind, and of the second kind one that has not finished."""
    for folder, counts in (("plain", (3, 4)), ("dagger", (7, 9))):
        for seed, successes in enumerate(counts):
            write_run(tmp_path / folder / f"run{seed}", seed, successes)
    unfinished = write_run(tmp_path / "dagger" / "run2", 2, 0)
    (unfinished / "summary.json").unlink()
    (tmp_path / "dagger" / "no_run").mkdir()
    return tmp_path


def test_labelled_patterns_and_lists(composed, runs, capsys):
    groups = f"runs={{with DAgger: {runs}/dagger/*, without: [{runs}/plain/run0, {runs}/plain/run1]}}"
    rows = compare.compare(composed(groups, recipe="compare"))
    assert [(row.label, row.seeds) for row in rows] == [("with DAgger", (0, 1)), ("without", (0, 1))]
    out = capsys.readouterr().out
    assert f"Left out: {runs}/dagger/run2 has no summary.json" in out and "-45.0 points" in out
    (folder,) = runs.glob("compare/*")
    assert {path.name for path in folder.iterdir()} == {
        *("config.yaml", "compare.md", "compare.csv", "compare.html")
    }


def test_labels_are_words_and_patterns_stand_in_quotes(run_recipe, runs):
    given = f'runs={{with DAgger: "{runs}/dagger/*", without: ["{runs}/plain/*"]}}'
    code, out, err = run_recipe("compare", given)
    assert code == 0, err
    assert "difference to with DAgger" in out


def test_a_failed_run_is_refused(composed, runs):
    write_job(runs / "sweep", SweepJob(0, (), runs / "dagger" / "run2", failure="out of memory."))
    with pytest.raises(ConfigError, match=r"run2 failed: out of memory\. Go on with resume="):
        compare.compare(composed(f"runs={{a: {runs}/dagger/*}}", recipe="compare"))


def test_a_label_may_name_a_sweep(composed, runs):
    for seed in (0, 1):
        write_job(
            runs / "sweep", SweepJob(seed, (f"seed={seed}",), runs / "plain" / f"run{seed}", ended=True)
        )
    write_job(runs / "sweep", SweepJob(2, ("seed=2",), failure="too large"))
    for sweep in ("sweep", "swe*"):
        groups = f"runs={{with DAgger: {runs}/dagger/*, without: {runs}/{sweep}}}"
        rows = compare.compare(composed(groups, recipe="compare"))
        assert [(row.label, row.seeds) for row in rows] == [("with DAgger", (0, 1)), ("without", (0, 1))]


def test_a_sweep_without_a_run_is_named(composed, runs):
    write_job(runs / "sweep", SweepJob(0, ("seed=0",), failure="too large"))
    for given in (f"runs={{mine: {runs}/sweep}}", f"runs={runs}/sweep"):
        with pytest.raises(ConfigError, match=r"no run directory|none of the sweep"):
            compare.compare(composed(given, recipe="compare"))


def test_a_sweep_is_compared_by_what_was_swept(composed, runs, capsys):
    for number, folder in enumerate(("plain", "dagger")):
        for seed in (0, 1):
            overrides = (f"seed={seed}", f"loss.bc_weight={number}", "experiment=smoke")
            write_job(
                runs / "sweep",
                SweepJob(2 * number + seed, overrides, runs / folder / f"run{seed}", ended=True),
            )
    write_job(
        runs / "sweep", SweepJob(4, ("seed=0", "loss.bc_weight=5", "experiment=smoke"), failure="too large")
    )
    rows = compare.compare(composed(f"runs={runs}/sweep", recipe="compare"))
    assert [row.label for row in rows] == ["loss.bc_weight=0", "loss.bc_weight=1"]
    assert (
        "Left out: job 4 (seed=0 loss.bc_weight=5 experiment=smoke) has no run: too large"
        in capsys.readouterr().out
    )
