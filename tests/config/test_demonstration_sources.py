"""Demonstrations as they are named: D_expert, what stands beside it, and a folder of kinds."""

import pytest

from torchgrasp.config.demonstration_sources import count_steps, list_demonstrations, make_source
from torchgrasp.data import begin_demonstrations
from torchgrasp.errors import ConfigError


def options(cfg):
    return {name: each.demonstrations for name, each in list_demonstrations(cfg).items()}


def test_alone_it_is_d_expert(composed, tmp_path):
    cfg = composed("demonstrations.steps=60")
    assert list(options(cfg)) == ["expert"] and count_steps(list_demonstrations(cfg).values()) == 60
    source = make_source(cfg, "expert", tmp_path)
    assert (source.count, source.labels, source.weight) == ("successful", True, None)


def test_further_ones_count_their_steps_by_a_ratio_and_have_every_option(composed, tmp_path):
    more = "demonstrations.more={failed: {kind: failed, ratio: 2.4, labels: false}, other: {kind: expert}}"
    cfg = composed("demonstrations.steps=50", "demonstrations.kind=learner", more)
    found = options(cfg)
    assert {name: (each.kind, each.steps) for name, each in found.items()} == {
        **{"expert": ("learner", 50), "failed": ("failed", 120), "other": ("expert", 50)}
    }
    assert found["failed"].path is None and found["other"].labels is True
    source = make_source(list_demonstrations(cfg)["failed"], "failed", tmp_path)
    assert (source.count, source.labels) == ("failed", False)


def test_a_folder_of_kinds_is_a_source_each(composed, tmp_path):
    for kind in ("expert", "failed"):
        begin_demonstrations(tmp_path / "kinds" / kind, kind=kind)
    cfg = composed(f"demonstrations.path={tmp_path / 'kinds'}")
    assert {name: each.kind for name, each in options(cfg).items()} == {
        "expert": "expert",
        "failed": "failed",
    }
    begin_demonstrations(tmp_path / "kinds" / "online")
    with pytest.raises(ConfigError, match="rename the folder"):
        list_demonstrations(cfg)


def test_the_rest_of_the_configuration_is_the_same_for_each(composed):
    cfg = composed("seed=4", "demonstrations.more={failed: {kind: failed}}")
    assert [each.seed for each in list_demonstrations(cfg).values()] == [4, 4]
