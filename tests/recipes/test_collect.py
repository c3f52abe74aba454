"""Demonstrations of every kind, collected as a user would, and a collection that was killed on the way."""

import json
import os
import random
import re
import signal
import subprocess
import time

import collect
import common
import pytest
import td3_bc
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from origin import check_rows
from runner import command, environment

from torchgrasp.data import count_shards, open_demonstrations
from torchgrasp.data.minari.exchange import export_minari, import_minari
from torchgrasp.errors import ConfigError
from torchgrasp.runs.weights import save_weights


@pytest.fixture
def collected(composed, tmp_path):
    """Collects in this process and returns the demonstrations."""

    def run(*overrides, name="demos"):
        cfg = composed("experiment=smoke", *overrides)
        with common.make_pool(cfg) as pool:
            collect.collect(cfg, pool, tmp_path / name)
        return open_demonstrations(tmp_path / name)

    return run


def write_weights(cfg, path):
    plain = OmegaConf.to_container(cfg, resolve=True)
    save_weights(path, {"actor": instantiate(cfg.model.actor)}, plain)
    return path


def check_equal(ours, theirs):
    assert ours.records == theirs.records and ours.num_shards == theirs.num_shards
    for rows, others in zip(ours.shards, theirs.shards, strict=True):
        assert set(rows.keys()) == set(others.keys()) and bool((rows == others).all())


def test_the_expert_alone_and_disturbed(collected):
    expert = collected("demonstrations.kind=expert", name="expert").card
    assert expert["kind"] == "expert" and expert["perturbed_steps"] == 0
    # Without a plan there is no label; in which scenes that is depends on the machine's arithmetic.
    assert expert["successful_steps"] >= 40 and expert["successful_steps"] <= expert["labelled_steps"]
    perturbed = collected("demonstrations.count=all", "collector.disturb.probability=1").card
    assert perturbed["kind"] == "perturbed" and perturbed["perturbed_steps"] > 0
    assert perturbed["steps"] == 48 and perturbed["provenance"]["disturb"]["probability"] == 1


def test_failures_alone_are_kept(collected):
    failed = collected("demonstrations.kind=failed")
    card = failed.card
    assert card["failed_steps"] == card["steps"] >= 40 and card["successes"] == 0
    assert card["episodes"] <= card["attempts"] == 8 * failed.num_shards
    assert not any(record.success for records in failed.records for record in records)


def test_an_expert_that_never_fails_ends_the_collection(collected, monkeypatch, tmp_path):
    """With time enough the expert lifts all of 8 objects of most seeds; of which depends on the machine."""
    monkeypatch.setattr(collect, "_HOPELESS", 8)
    given = ["demonstrations.kind=failed", "collector.disturb_to_fail.probability=0", "env.horizon=15"]
    ended = []
    for seed in range(6):
        try:
            collected(*given, f"seed={seed}", "demonstrations.steps=1", name=str(seed))
        except ConfigError as error:
            ended.append((seed, str(error)))
    assert ended
    for seed, message in ended:
        assert re.search("failed in none of 8 episodes.*disturb_to_fail", message)
        empty = open_demonstrations(tmp_path / str(seed))
        assert (empty.num_shards, empty.num_episodes, empty.card["attempts"]) == (1, 0, 8)


def test_a_learner_acts_and_the_expert_labels_every_state(composed, collected, tmp_path):
    weights = write_weights(composed("experiment=smoke", "seed=3"), tmp_path / "weights.safetensors")
    given = ["demonstrations.kind=learner", f"demonstrations.policy={weights}"]
    alone = collected(*given, name="alone")
    assert alone.card["steps"] >= 40 and alone.card["labelled_steps"] > 0.5 * alone.card["steps"]
    rows = alone.shards[0]
    assert not bool((rows["action"] == rows["expert_action"]).all(-1).any())
    begun = collected(
        *given, "demonstrations.expert_start=true", "collector.expert_start.probability=1", name="begun"
    )
    same = (begun.shards[0]["action"] == begun.shards[0]["expert_action"]).all(-1)
    assert 0 < int(same.sum()) < len(same)
    with pytest.raises(ConfigError, match="learned with another transforms"):
        collected(*given, "transforms.sample.num_points=40", name="other")


def test_a_collection_goes_on_only_as_it_was_begun(composed, collected):
    first = collected()
    more = collected("demonstrations.steps=90")
    assert more.num_shards > first.num_shards
    check_equal(more, collected("demonstrations.steps=90", name="at_once"))
    with pytest.raises(ConfigError, match="another seed"):
        collected("seed=5")
    with pytest.raises(ConfigError, match="another disturb"):
        collected("collector.disturb.probability=0.4")
    with pytest.raises(ConfigError, match="kind perturbed, not expert"):
        collected("demonstrations.kind=expert")


def test_training_takes_demonstrations_of_another_seed_but_not_of_another_kind(composed, collected):
    path = collected().path
    cfg = composed("experiment=smoke", "seed=5", f"demonstrations.path={path}")
    with common.make_pool(cfg) as pool:
        (source,) = collect.demonstrations(cfg, pool, path.parent)
        assert (source.name, source.path, source.count) == ("expert", path, "successful")
        cfg.demonstrations.kind = "learner"
        with pytest.raises(ConfigError, match="kind perturbed, not learner"):
            collect.demonstrations(cfg, pool, path.parent)


def import_export(demonstrations, folder, *, told):
    """The demonstrations through Minari and back; without `told`, as a dataset of somebody else."""
    minari = pytest.importorskip("minari")
    exported = export_minari(demonstrations, folder / "away-v0")
    if not told:
        file = exported / "data" / "metadata.json"
        metadata = json.loads(file.read_text())
        del metadata["torchgrasp"]
        file.write_text(json.dumps(metadata))
    assert minari.MinariDataset(exported / "data").total_episodes == demonstrations.num_episodes
    import_minari(exported, folder / "back", kind="perturbed")
    return folder / "back"


@pytest.mark.parametrize("told", [True, False])
def test_training_takes_imports(composed, collected, tmp_path, told):
    path = import_export(collected(), tmp_path, told=told)
    given = ["total_env_steps=0", "evaluation.episodes=1", "evaluation.baselines=[]"]
    given += [] if told else ["replay.codec.state_keys=[time_left]"]  # what an import keeps by default
    summary = td3_bc.train(composed("experiment=smoke", f"demonstrations.path={path}", *given))
    assert summary["gradient_steps"] == 6 and summary["demonstrations"]["successful_steps"] >= 40
    if told:
        with pytest.raises(ConfigError, match="another transforms"):
            cfg = composed(
                "experiment=smoke", f"demonstrations.path={path}", "transforms.sample.num_points=40"
            )
            collect.demonstrations(cfg, None, tmp_path)
    opened = open_demonstrations(path)
    row = next(opened.iterate_rows())[:1]
    check_rows(opened, row)
    with pytest.raises(ConfigError, match=r"'points' of shape \(32, 3\).*\(40, 3\)"):
        check_rows(opened, row.set("points", torch.zeros(1, 40, 3)))


def test_training_on_less_than_was_asked_for_says_so(composed, collected, tmp_path, capsys):
    path = collected("demonstrations.kind=expert").path
    given = ["experiment=smoke", "demonstrations.kind=expert", f"demonstrations.path={path}"]
    assert [each.path for each in collect.demonstrations(composed(*given), None, tmp_path)] == [path]
    assert capsys.readouterr().out == ""
    collect.demonstrations(composed(*given, "demonstrations.steps=999"), None, tmp_path)
    assert "demonstrations.steps=999 asks for more" in capsys.readouterr().out


def test_killed_at_any_moment_and_resumed_equals_never_killed(collected, tmp_path):
    """Killed by SIGKILL while two workers collect; shards hold the failures of their rounds alone."""
    given = ["demonstrations.kind=failed", "demonstrations.steps=200"]
    path = tmp_path / "killed"
    process = subprocess.Popen(
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
    resumed = collected(*given, name="killed")
    check_equal(resumed, collected(*given, name="whole"))
