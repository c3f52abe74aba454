"""The suite `agent`, on a few episodes."""

import grasp_agent
import pytest

FEW = ["agent.objects=2", "agent.worlds=2", "agent.episodes=2", "agent.timed=1", "agent.scenes=2"]


@pytest.mark.slow
def test_an_agent_is_compared_timed_and_given_another_camera(composed, capsys):
    *motions, timed, ours, wide = grasp_agent.benchmark_agent(composed(*FEW))
    assert [row["motion"] for row in motions] == ["static", "jitter", "handover"]
    assert all(row["largest_difference"] <= 1e-6 and row["steps"] == 60 for row in motions)
    assert 0.0 < timed["act_milliseconds"] <= timed["act_milliseconds_p95"] and timed["steps"] == 30
    assert ours["episodes"] == wide["episodes"] == 2
    assert "camera 848 x 480" in capsys.readouterr().out
