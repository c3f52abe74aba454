"""recipes/collect.py: a folder of demonstrations, also one whose collection was killed on the way."""

import os
import random
import signal
import subprocess
import time

import pytest

from recipes import collect
from tests.recipes.runner import command, environment
from tests.warm_python import WarmProcess
from torchgrasp.data import count_shards, open_demonstrations


def check_equal(ours, theirs):
    assert ours.records == theirs.records and ours.num_shards == theirs.num_shards
    for rows, others in zip(ours.shards, theirs.shards, strict=True):
        assert set(rows.keys()) == set(others.keys()) and bool((rows == others).all())


def test_it_collects_into_its_folder_and_tells_what(composed, tmp_path, capsys):
    card = collect.run(composed("experiment=smoke", "demonstrations.steps=6"))
    assert open_demonstrations(tmp_path / "demonstrations").card == card
    assert card["successful_steps"] >= 6
    told = f"{card['episodes']} perturbed episodes of {card['attempts']} run, {card['successes']} successful"
    assert f"{tmp_path}/demonstrations: {told}" in capsys.readouterr().out
    again = collect.run(composed("experiment=smoke", "demonstrations.steps=6"))
    assert again == card  # enough is there


@pytest.mark.slow
def test_killed_at_any_moment_and_resumed_equals_never_killed(composed, tmp_path):
    """Killed by SIGKILL while two workers collect; shards hold the failures of their rounds alone."""
    given = ["demonstrations.kind=failed", "demonstrations.steps=200"]
    path = tmp_path / "killed"
    process = WarmProcess(
        command(
            *("collect", tmp_path, "experiment=smoke", *given),
            *("collector.num_workers=2", f"demonstrations.path={path}"),
        ),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment(),
    )
    while not count_shards(path) and process.poll() is None:
        time.sleep(0.01)
    delay = random.SystemRandom().uniform(0.0, 3.0)
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    print(f"killed {delay:.2f} s after the first shard, with {count_shards(path)} shards")
    for name in ("killed", "whole"):
        collect.run(composed("experiment=smoke", *given, f"demonstrations.path={tmp_path / name}"))
    check_equal(*(open_demonstrations(tmp_path / name) for name in ("killed", "whole")))
