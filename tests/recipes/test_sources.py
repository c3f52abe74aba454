"""Several sources of demonstrations: named, weighted, with labels or without; offline and without DAgger."""

import shutil

import collect
import common
import pytest
import td3_bc
from learner import Learner
from sources import list_demonstrations, share_batch
from test_bc import SHORT, find_run, stored_rows

from torchgrasp.errors import ConfigError


def test_offline_learns_from_successes_and_from_failures_without_labels(composed, tmp_path):
    cell = ["experiment=[smoke,table3/offline]", "offline.updates=5", *SHORT]
    summary = td3_bc.train(composed(*cell))
    assert summary["env_steps"] == 0 and summary["gradient_steps"] == 6 + 5
    assert summary["demonstrations"]["kind"] == "perturbed"
    assert summary["more_demonstrations"]["failed"]["successes"] == 0
    assert summary["more_demonstrations"]["failed"]["steps"] >= 96
    run_dir = find_run(tmp_path, "td3_bc")
    failed, expert = (stored_rows(run_dir, name) for name in ("failed", "expert"))
    assert not failed["episode_success"].any() and expert["episode_success"].all()
    assert not failed["has_expert"].any() and not failed["has_goal"].any()
    assert expert["has_expert"].float().mean() > 0.5


def test_without_dagger_the_learners_steps_keep_goals_but_no_expert(composed, tmp_path):
    td3_bc.train(composed("experiment=[smoke,table3/no_dagger]", "total_env_steps=12", *SHORT))
    rows = stored_rows(find_run(tmp_path, "td3_bc"), "online")
    assert not rows["has_expert"].any() and rows["has_goal"].float().mean() > 0.5


def test_batches_draw_by_steps_or_by_weight(composed, tmp_path):
    failed, other = "{kind: failed, steps: 24, labels: false}", "{kind: expert, steps: 24%s}"
    more = f"demonstrations.more={{failed: {failed}, other: {other}}}"
    shares = []
    for weight in ("", ", weight: 0"):
        cfg = composed("experiment=smoke", "replay.online_fraction=0.5", more % weight)
        learner = Learner(cfg, common.observed_shapes(cfg))
        with common.make_pool(cfg) as pool:
            sources = collect.demonstrations(cfg, pool, tmp_path)
        learner.experience.make_buffer(sources)
        shares.append(learner.buffer.shares)
        learner.experience.draw_demonstrations()
        assert learner.buffer.shares["failed"] == 0 and learner.buffer.shares["online"] == 0
    counted = {each.name: collect.open_demonstrations(each.path).card for each in sources}
    steps = [counted["expert"]["successful_steps"], counted["failed"]["failed_steps"]]
    steps.append(counted["other"]["successful_steps"])
    expected = [0.5, *(0.5 * each / sum(steps) for each in steps)]
    assert list(shares[0].values()) == pytest.approx(expected)
    assert shares[1]["other"] == 0 and sum(shares[1].values()) == pytest.approx(1.0)


def test_a_folder_of_kinds_is_a_source_each(composed, tmp_path):
    for kind in ("expert", "failed"):
        cfg = composed("experiment=smoke", f"demonstrations.kind={kind}", "demonstrations.steps=12")
        with common.make_pool(cfg) as pool:
            collect.collect(cfg, pool, tmp_path / "kinds" / kind)
    cfg = composed(
        "experiment=smoke", f"demonstrations.path={tmp_path / 'kinds'}", "total_env_steps=0", *SHORT
    )
    found = list_demonstrations(cfg)
    assert {name: each.demonstrations.kind for name, each in found.items()} == {
        "expert": "expert",
        "failed": "failed",
    }
    summary = td3_bc.train(cfg)
    assert summary["demonstrations"]["kind"] == "expert" and "failed" in summary["more_demonstrations"]
    shutil.move(tmp_path / "kinds" / "failed", tmp_path / "kinds" / "online")
    with pytest.raises(ConfigError, match="rename the folder"):
        list_demonstrations(cfg)


def test_shares_by_hand():
    assert share_batch("online", 0.7, {"expert": 50, "failed": 100}) == pytest.approx(
        {"online": 0.7, "expert": 0.1, "failed": 0.2}
    )


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("{online: {kind: failed}}", "give another name"),
        ("{failures: {steps: 3}}", "give kind"),
        ("{failures: {kind: failed, stesp: 3}}", "give kind"),
        ("{failures: {kind: failed, ratio: 0}}", "ratio"),
        ("{failures: {kind: failed, steps: 0}}", "steps"),
        ("{failures: {kind: none}}", "is unknown"),
        ("{failures: {kind: failed, labels: 3}}", "no switch"),
    ],
)
def test_impossible_sources(composed, more, told):
    with pytest.raises(ConfigError, match=told):
        td3_bc.train(composed("experiment=smoke", f"demonstrations.more={more}"))


def test_demonstrations_that_teach_nothing_are_refused(composed):
    with pytest.raises(ConfigError, match="No demonstrations are left"):
        td3_bc.train(composed("experiment=smoke", "demonstrations.labels=false", *SHORT))
