"""What no training can work with is refused before anything is written, by its place."""

import pytest

from torchgrasp.config.training_checks import check_training
from torchgrasp.errors import ConfigError


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["demonstrations.kind=best"], r"^demonstrations\.kind='best' .*expert, perturbed, failed, learner"),
        (["demonstrations.count=none"], r"^demonstrations\.count='none' .*one of all, successful, failed"),
        (["demonstrations.kind=failed", "demonstrations.count=successful"], "keeps nothing"),
        (["demonstrations.kind=learner"], "needs a policy"),
        (["demonstrations.kind=learner", "demonstrations.policy=no/such/run"], "no/such/run"),
        (["demonstrations.policy=some/run"], "no other kind takes one"),
        (["collector.disturb=null"], "collector.disturb=None .* demonstrations.kind=expert"),
        (["demonstrations.kind=failed", "collector.disturb_to_fail=3"], "collector.disturb_to_fail=3"),
        (["total_env_steps=0", "offline.updates=auto"], "which is 0: give their number"),
        (["init=nowhere"], "^init='nowhere' is not there"),
        (["online.decay=0"], r"^online\.decay=0 is out of range"),
    ],
)
def test_impossible_values(composed, overrides, told):
    with pytest.raises(ConfigError, match=told):
        check_training(composed(*overrides))


def test_what_is_not_needed_may_be_left_out(composed):
    check_training(composed("demonstrations.kind=expert", "collector.disturb=null"))


@pytest.mark.parametrize("option", ["init", "demonstrations.policy"])
def test_a_directory_without_weights_is_told_from_none(composed, tmp_path, option):
    learner = ["demonstrations.kind=learner"] * (option != "init")
    for name, told in ((tmp_path, "holds no weights.safetensors"), (tmp_path / "nobody", "is not there")):
        with pytest.raises(ConfigError, match=told):
            check_training(composed(f"{option}={name}", *learner))


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("{online: {kind: failed}}", r"^demonstrations\.more\.online: give another name"),
        ("{failures: {steps: 3}}", r"^demonstrations\.more\.failures=.*give kind"),
        ("{failures: {kind: failed, stesp: 3}}", r"^demonstrations\.more\.failures=.*give kind"),
        ("{failures: {kind: failed, ratio: 0}}", r"^demonstrations\.more\.failures\.ratio=0"),
        ("{failures: {kind: failed, steps: 0}}", r"^demonstrations\.more\.failures\.steps=0"),
        ("{failures: {kind: none}}", r"^demonstrations\.more\.failures\.kind='none' is unknown"),
        ("{failures: {kind: failed, labels: 3}}", r"^demonstrations\.more\.failures\.labels=3 is no switch"),
        ("{failures: {kind: failed, weight: -1}}", r"^demonstrations\.more\.failures\.weight=-1"),
        ("[failed]", r"^demonstrations\.more=\['failed'\]: give"),
    ],
)
def test_further_demonstrations_are_refused_by_their_own_place(composed, more, told):
    with pytest.raises(ConfigError, match=told):
        check_training(composed(f"demonstrations.more={more}"))
