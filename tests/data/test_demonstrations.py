import importlib.metadata
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
import torch

from tests.data.rollouts import append, make_episodes
from torchgrasp.data import (
    MixtureReplayBuffer,
    append_shard,
    begin_demonstrations,
    count_shards,
    open_demonstrations,
)
from torchgrasp.errors import ConfigError


def test_episodes_come_back_as_they_were(tmp_path):
    for index in range(3):
        append(tmp_path, index)
    episodes = [episode for index in range(3) for episode in make_episodes(index)]
    read = list(open_demonstrations(tmp_path).iterate_episodes())
    assert len(read) == len(episodes)
    for old, new in zip(episodes, read, strict=True):
        assert new.shape == old.shape
        for key in ("points", "time_left", "action", "expert_action", "goal", "has_goal", "perturbed"):
            assert torch.equal(new[key], old[key])
        assert torch.equal(new["next", "reward"], old["next", "reward"])
        live = ~old["next", "terminated"].squeeze(-1)
        assert torch.equal(new["next", "points"][live], old["next", "points"][live])


def test_card_counts_what_the_shards_hold(tmp_path):
    card = append(tmp_path, 0)
    card = append(tmp_path, 1)
    episodes = make_episodes(0) + make_episodes(1)
    successes = sum(int(e["next", "reward"][-1].item() > 0.5) for e in episodes)
    told = json.loads((tmp_path / "card.json").read_text())
    assert card == {name: told[name] for name in card} == open_demonstrations(tmp_path).card
    assert (card["episodes"], card["successes"], card["shards"]) == (len(episodes), successes, 2)
    assert sum(counts["episodes"] for counts in card["objects"].values()) == len(episodes)
    on_disk = sum(f.stat().st_size for f in tmp_path.rglob("rows/**/*") if f.is_file())
    assert card["bytes"] == on_disk


def test_demonstrations_fill_a_buffer_without_being_decoded(tmp_path):
    append(tmp_path, 0)
    demonstrations = open_demonstrations(tmp_path)
    buffer = MixtureReplayBuffer({"expert": 1000}, {"expert": 1.0}, batch_size=32)
    for rows in demonstrations.iterate_rows():
        buffer.extend_rows(rows, source="expert")
    assert buffer.num_rows()["expert"] == sum(len(e) for e in make_episodes(0))
    batch = buffer.sample()
    live = ~batch["next", "terminated"].squeeze(-1)
    assert torch.equal(batch["next", "time_left"][live], batch["time_left"][live] + 1)


def test_a_collection_goes_on_after_its_last_complete_shard(tmp_path):
    path = tmp_path / "demos"
    assert count_shards(path) == 0
    append(path, 0)
    # What a killed process leaves behind: a part of the next shard.
    shutil.copytree(path / "shard_00000" / "rows", path / ".shard_00001.new" / "rows")
    assert count_shards(path) == 1
    append(path, count_shards(path))
    expected = len(make_episodes(0)) + len(make_episodes(1))
    assert open_demonstrations(path).num_episodes == expected
    assert not list(path.glob(".shard*"))


def test_a_killed_collection_loses_and_doubles_nothing(tmp_path):
    path = tmp_path / "demos"
    script = f"""
        import sys
        sys.path.insert(0, {str(Path(__file__).parents[2])!r})
        from tests.data import rollouts as t
        from torchgrasp.data import count_shards
        for index in range(count_shards({str(path)!r}), 1000):
            t.append({str(path)!r}, index)
    """
    child = subprocess.Popen([sys.executable, "-W", "ignore", "-c", textwrap.dedent(script)])
    deadline = time.monotonic() + 60
    while count_shards(path) < 3 and time.monotonic() < deadline:
        time.sleep(0.001)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    killed_at = count_shards(path)
    for index in range(killed_at, killed_at + 2):
        append(path, index)
    demonstrations = open_demonstrations(path)
    assert demonstrations.num_shards == killed_at + 2 >= 5
    read = demonstrations.iterate_episodes()
    for index in range(demonstrations.num_shards):
        for episode in make_episodes(index):
            assert torch.equal(next(read)["action"], episode["action"])
    assert next(read, None) is None


def test_shards_out_of_order_are_refused(tmp_path):
    append(tmp_path, 0)
    for index in (0, 2):
        with pytest.raises(ConfigError, match="append 1"):
            append(tmp_path, index)


def test_parts_of_episodes_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="split_episodes"):
        append(tmp_path, 0, [make_episodes(0)[0][:-1]])


def test_card_tells_what_was_run_and_where_it_comes_from(tmp_path):
    begin_demonstrations(tmp_path, kind="failed", provenance={"seed": 3})
    episodes = [e for e in make_episodes(0) if e["next", "reward"][-1] < 0.5]
    card = append_shard(
        tmp_path,
        episodes,
        objects=["mug"] * len(episodes),
        seeds=[3] * len(episodes),
        index=0,
        attempts=20,
        wall_seconds=1.5,
    )
    steps = sum(map(len, episodes))
    assert (card["kind"], card["provenance"], card["seeds"]) == ("failed", {"seed": 3}, [3])
    assert (card["attempts"], card["episodes"], card["successes"]) == (20, len(episodes), 0)
    assert (card["steps"], card["failed_steps"], card["successful_steps"]) == (steps, steps, 0)
    assert card["perturbed_steps"] == sum(int(e["perturbed"].sum()) for e in episodes)
    assert card["labelled_steps"] == sum(int(e["has_expert"].sum()) for e in episodes)
    assert card["wall_seconds"] == 1.5 and card["bytes_per_step"] == round(card["bytes"] / steps, 1)
    assert card["versions"]["torch"] == [importlib.metadata.version("torch")]


def test_empty_shards_are_shards(tmp_path):
    begin_demonstrations(tmp_path, kind="failed")
    nothing = append_shard(tmp_path, [], objects=[], seeds=[], index=0, attempts=8)
    assert (nothing["attempts"], nothing["episodes"], nothing["success_rate"]) == (8, 0, 0.0)
    append(tmp_path, 1)
    card = append_shard(tmp_path, [], objects=[], seeds=[], index=2, attempts=8)
    demonstrations = open_demonstrations(tmp_path)
    assert demonstrations.num_shards == 3 and demonstrations.card == card
    assert len(list(demonstrations.iterate_episodes())) == len(make_episodes(1))
    assert len(list(demonstrations.iterate_rows())) == 1


def test_one_folder_holds_one_kind(tmp_path):
    begin_demonstrations(tmp_path / "demos", kind="expert", provenance={"seed": 1})
    again = begin_demonstrations(tmp_path / "demos", kind="expert", provenance={"seed": 2})
    assert again["provenance"] == {"seed": 1}
    with pytest.raises(ConfigError, match="kind expert, not learner"):
        begin_demonstrations(tmp_path / "demos", kind="learner")
    with pytest.raises(ConfigError, match=r"'best'.*expert, perturbed, failed, learner"):
        begin_demonstrations(tmp_path / "others", kind="best")
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="is a file"):
        begin_demonstrations(tmp_path / "file")
