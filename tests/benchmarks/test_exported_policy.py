"""The suite `export`, on one episode."""

import exported_policy
import pytest


@pytest.mark.slow
def test_an_exported_policy_is_compared_and_timed(composed, capsys):
    rows = exported_policy.benchmark_export(composed("export.objects=2", "export.states=20"))
    assert [row["what"] for row in rows] == ["network", "whole way"]
    for row in rows:
        assert row["states"] == 30 and row["largest_action_difference"] <= 1e-5
        assert row["largest_goal_difference"] <= 5e-5
        assert row["torch_milliseconds"] > 0.0 and row["exported_milliseconds"] > 0.0
    assert "whole way: over 30 states" in capsys.readouterr().out
