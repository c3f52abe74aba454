"""Two hosts made of namespaces, of which one is cut off, comes back, and is killed."""

import os
import subprocess
import sys

import pytest
from network_hosts import tell_lack

from tests.benchmarks.conftest import BENCHMARKS


@pytest.mark.slow
def test_a_host_that_is_cut_off_or_killed_costs_its_episodes_and_nothing_else():
    """The whole trial, in its short form; the script itself compares the metrics."""
    pytest.importorskip("ray", reason="needs the extra ray")
    pytest.importorskip("setuptools", minversion="77", reason="builds the wheel")
    if (lack := tell_lack()) is not None:
        pytest.skip(f"no hosts can be made of namespaces: {lack}")
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "two_hosts.py"), "--short"],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    told = [line.partition(" s  ")[2] for line in done.stdout.splitlines()]
    assert sum("10.77.0.2) was lost (its machine does not answer)" in line for line in told) == 2
    assert sum("the first host goes on alone" in line for line in told) == 2
    assert any("the second host is used again" in line for line in told)
    assert "one process gives the same metrics" in told[-1]
