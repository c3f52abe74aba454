import pytest
import torch
from tensordict import TensorDict

from tests.run_files import success_table
from torchgrasp.evaluation.success import SuccessTable, find_gain
from torchgrasp.report import console
from torchgrasp.rollouts.episode_pool import Episode


def test_policies_are_printed_with_the_policy_last(capsys):
    tables = {"policy": success_table(8), "expert": success_table(10)}
    console.print_comparison(tables, episodes=10, scenes="the test split")
    head, expert, policy = capsys.readouterr().out.strip().splitlines()
    assert head == "Success on the same 10 scenes of the test split, 95 % interval"
    # Wilson's interval of 8 of 10, by hand.
    assert expert.split()[:3] == ["expert", "100.0", "%"] and policy.split("  ")[-1] == "[49.0, 94.3]"


def test_gains_are_printed_below_in_points(capsys):
    gain = find_gain(success_table(8), success_table(10))
    assert gain["gain"] == pytest.approx(-0.2) and gain["ci95"][0] < -0.2 < gain["ci95"][1]
    console.print_gains({"added by reinforcement": gain})
    assert capsys.readouterr().out.split()[:5] == ["added", "by", "reinforcement", "-20.0", "points"]


def test_failures_are_printed_with_their_objects(capsys):
    console.print_failures(success_table(8))
    out = capsys.readouterr().out
    assert "2 of the 2 objects met were lifted at least once" in out and "   2 failed: slipped" in out


def test_groups_of_takeovers_are_printed_in_order(capsys):
    rows = success_table(8)["objects"]
    console.print_learner_steps({"learner_steps": {"11-15": rows["bowl"], "0-5": rows["mug"]}})
    lines = capsys.readouterr().out.strip().splitlines()
    assert [line.split()[0] for line in lines[1:]] == ["0-5", "11-15"]
    console.print_learner_steps({})
    assert not capsys.readouterr().out


@pytest.mark.parametrize(
    ("steps", "name"), [(0, "0-5"), (5, "0-5"), (6, "6-10"), (10, "6-10"), (11, "11-15"), (30, "26-30")]
)
def test_learner_steps_are_counted_in_fives(steps, name):
    turn = (torch.arange(30) >= steps).long()
    assert console.learner_steps(Episode(TensorDict({"turn": turn}, [30]), "mug", 0, 0)) == name


def test_the_worst_objects_come_first_and_those_without_failure_never():
    table = SuccessTable()
    for name, outcomes in {"never": "11", "half": "10", "once": "0", "often": "0000"}.items():
        for outcome in outcomes:
            table.add(name, outcome == "1")
    assert list(console.worst_objects(table.rows())) == ["often", "once", "half"]
    assert list(console.worst_objects(table.rows(), at_most=1)) == ["often"]
