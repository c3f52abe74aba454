import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.run_groups import find_groups
from torchgrasp.runs.sweep_record import SweepJob, write_job


@pytest.fixture
def runs(tmp_path):
    """Two runs with a summary, one without, and a sweep of the first two, whose third job has no run."""
    for name in ("run0", "run1", "unfinished"):
        (tmp_path / "bc" / name).mkdir(parents=True)
    for number, name in enumerate(("run0", "run1")):
        (tmp_path / "bc" / name / "summary.json").write_text("{}")
        overrides = ("seed=0", f"loss.bc_weight={number}")
        write_job(tmp_path / "sweep", SweepJob(number, overrides, tmp_path / "bc" / name, ended=True))
    write_job(tmp_path / "sweep", SweepJob(2, ("seed=0", "loss.bc_weight=5"), failure="too large"))
    return tmp_path


def find(runs) -> dict[str, list[str]]:
    groups = find_groups(runs, label="all", holding="summary.json")
    return {label: [run.name for run in group] for label, group in groups.items()}


def test_a_directory_a_pattern_or_a_list_has_the_label_given(runs):
    assert find(f"{runs}/bc/unfinished") == {"all": ["unfinished"]}
    assert find(f"{runs}/bc/*") == {"all": ["run0", "run1"]}  # those that hold a summary
    assert find([f"{runs}/bc/run1", f"{runs}/bc/*"]) == {"all": ["run1", "run0"]}  # each once


def test_labels_keep_their_order(runs, capsys):
    given = {"with DAgger": f"{runs}/sweep", 3: (f"{runs}/bc/run1",)}
    assert find(given) == {"with DAgger": ["run0", "run1"], "3": ["run1"]}
    assert "Left out: job 2 (seed=0 loss.bc_weight=5) has no run: too large" in capsys.readouterr().out


def test_a_sweep_alone_is_labelled_by_what_was_swept(runs):
    assert find(f"{runs}/sweep") == {"loss.bc_weight=0": ["run0"], "loss.bc_weight=1": ["run1"]}


@pytest.mark.parametrize("given", ["{}/nowhere/*", ["{}/bc/run0", "{}/bc/none"], {"mine": "{}/none"}, 7])
def test_what_is_not_there_is_named(runs, given):
    if isinstance(given, dict):
        given = {label: pattern.format(runs) for label, pattern in given.items()}
    elif not isinstance(given, int):
        given = [each.format(runs) for each in given] if isinstance(given, list) else given.format(runs)
    with pytest.raises(ConfigError, match=r"runs=.*\(all|mine\): no run directory with summary\.json"):
        find(given)


def test_a_sweep_without_a_run_is_named(tmp_path):
    write_job(tmp_path / "sweep", SweepJob(0, ("seed=0",), failure="too large"))
    with pytest.raises(ConfigError, match="none of the sweep's jobs has a run directory"):
        find(f"{tmp_path}/sweep")
