"""Demonstrations of every kind as configured, and folders that are given."""

import json

import pytest
import torch

from torchgrasp.config import gather_sources, given_sources, make_expert, make_pool, make_split_env
from torchgrasp.config.demonstration_folders import make_collecting_policy, take_given
from torchgrasp.config.networks import rebuild_acting
from torchgrasp.config.weights_files import read_trained
from torchgrasp.data import open_demonstrations
from torchgrasp.data.demonstration_sources import check_rows
from torchgrasp.data.minari.exchange import export_minari, import_minari
from torchgrasp.errors import ConfigError

CONDITIONED = ["model.actor.goal_input=true", "model.critic.goal_input=true"]


def test_the_expert_alone_and_disturbed(collected):
    expert = collected("demonstrations.kind=expert", name="expert").card
    assert expert["kind"] == "expert" and expert["perturbed_steps"] == 0
    # Without a plan there is no label; in which scenes that is depends on the machine's arithmetic.
    assert expert["successful_steps"] >= 40 and expert["successful_steps"] <= expert["labelled_steps"]
    perturbed = collected("demonstrations.count=all", "collector.disturb.probability=1").card
    assert perturbed["kind"] == "perturbed" and perturbed["perturbed_steps"] > 0
    assert perturbed["steps"] == 48 and perturbed["provenance"]["disturb"]["probability"] == 1


@pytest.mark.slow
def test_a_learner_acts_and_the_expert_labels_every_state(collected, untrained):
    given = ["demonstrations.kind=learner", f"demonstrations.policy={untrained('seed=3')}"]
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


def test_demonstrations_of_a_goal_conditioned_learner_keep_the_labels(composed, untrained):
    """Its goal network writes predictions under the labels' key; the expert's goals are what is recorded."""
    path = untrained(*CONDITIONED)
    given = ["demonstrations.kind=learner", f"demonstrations.policy={path}"]
    cfg = composed("experiment=smoke", *given, *CONDITIONED)
    td = make_split_env(cfg, "train").reset()
    told = make_expert(cfg, "train", execute=False)(td.clone())
    acted = make_collecting_policy(cfg)(td.clone())
    torch.testing.assert_close(acted["goal"], told["goal"])
    networks = rebuild_acting(read_trained(path))
    predicted = networks["goal_network"](td.clone())["goal"]
    expected = networks["actor"](td.clone().set("goal", predicted))["action"]
    torch.testing.assert_close(acted["action"], expected)


def test_a_collection_goes_on_only_as_it_was_begun(collected):
    first = collected("demonstrations.steps=1").num_shards
    assert collected("demonstrations.steps=60").num_shards > first
    with pytest.raises(ConfigError, match="another seed"):
        collected("seed=5")
    with pytest.raises(ConfigError, match=r"kind perturbed, not expert"):
        collected("demonstrations.kind=expert")


def test_what_has_no_path_is_collected_beside_the_run(composed, tmp_path):
    more = "demonstrations.more={failed: {kind: failed, steps: 6, labels: false, weight: 2}}"
    cfg = composed("experiment=smoke", "demonstrations.steps=6", more)
    with make_pool(cfg) as pool:
        expert, failed = gather_sources(cfg, pool, tmp_path)
    assert expert.path == tmp_path / "demonstrations" and failed.path == tmp_path / "demonstrations_failed"
    assert (failed.count, failed.labels, failed.weight) == ("failed", False, 2)
    assert open_demonstrations(failed.path).card["failed_steps"] >= 6


def test_training_takes_demonstrations_of_another_seed_but_not_of_another_kind(composed, demonstrations):
    cfg = composed("experiment=smoke", "seed=5", f"demonstrations.path={demonstrations}")
    (source,) = given_sources(cfg)
    assert (source.name, source.path, source.count) == ("expert", demonstrations, "successful")
    cfg.demonstrations.kind = "learner"
    with pytest.raises(ConfigError, match="kind perturbed, not learner"):
        given_sources(cfg)


def test_less_than_was_asked_for_is_told(composed, demonstrations, capsys):
    given = ["experiment=smoke", f"demonstrations.path={demonstrations}"]
    take_given(composed(*given, "demonstrations.steps=1"), "expert")
    assert capsys.readouterr().out == ""
    take_given(composed(*given, "demonstrations.steps=999"), "expert")
    assert "demonstrations.steps=999 asks for more" in capsys.readouterr().out


def test_folders_that_hold_nothing_of_use_are_refused(composed, tmp_path, demonstrations):
    with pytest.raises(ConfigError, match=r"demonstrations\.path=.*nowhere holds none"):
        given_sources(composed("experiment=smoke", f"demonstrations.path={tmp_path / 'nowhere'}"))
    here = f"demonstrations.path={demonstrations}"
    more = "demonstrations.more={failed: {kind: failed}}"
    with pytest.raises(
        ConfigError, match=r"demonstrations\.more\.failed has no path.* give failed that folder"
    ):
        given_sources(composed("experiment=smoke", here, more))


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
def test_training_takes_imports(composed, demonstrations, tmp_path, told):
    path = import_export(open_demonstrations(demonstrations), tmp_path, told=told)
    cfg = composed("experiment=smoke", f"demonstrations.path={path}")
    assert [each.path for each in given_sources(cfg)] == [path]
    if told:
        with pytest.raises(ConfigError, match="another transforms"):
            given_sources(composed("experiment=smoke", f"demonstrations.path={path}", "num_points=40"))
    opened = open_demonstrations(path)
    row = next(opened.iterate_rows())[:1]
    check_rows(opened, row)
    with pytest.raises(ConfigError, match=r"'points' of shape \(32, 3\).*\(40, 3\)"):
        check_rows(opened, row.set("points", torch.zeros(1, 40, 3)))
