"""Where demonstrations come from: what decides their episodes, and what training may change."""

import pytest
from omegaconf import OmegaConf

from torchgrasp.config.provenance import (
    check_learner,
    check_same_collection,
    check_usable,
    describe_provenance,
)
from torchgrasp.errors import ConfigError


@pytest.fixture
def described(composed):
    return lambda *overrides: describe_provenance(composed("experiment=smoke", *overrides))


def test_plain_values_tell_the_episodes_and_nothing_else(described):
    told = described("demonstrations.kind=expert")
    assert (
        told == OmegaConf.to_container(OmegaConf.create(told)) and told["camera"]["intrinsics"]["width"] == 32
    )
    assert told == described("demonstrations.kind=expert", "model.width=2", "online.updates=9")
    assert "disturb" not in told and described()["disturb"]["probability"] == 0.3
    assert described("demonstrations.kind=failed")["disturb"]["probability"] == 0.7


def test_a_learner_is_told_by_its_weights(described, untrained):
    learner = ["demonstrations.kind=learner", f"demonstrations.policy={untrained()}"]
    told, other = described(*learner), described(*learner[:1], f"demonstrations.policy={untrained('seed=1')}")
    assert told["policy"] != other["policy"] and told["expert_start"] is None
    begun = described(*learner, "demonstrations.expert_start=true")
    assert begun["expert_start"]["_target_"].endswith("ExpertStart")


def test_a_collection_goes_on_only_as_it_was_begun(described, tmp_path):
    card = {"provenance": described()}
    check_same_collection(described(), tmp_path, card)
    for given, told in (
        ("seed=5", "another env|another seed"),
        ("collector.disturb.probability=0.4", "disturb"),
    ):
        with pytest.raises(ConfigError, match=told):
            check_same_collection(described(given), tmp_path, card)
    with pytest.raises(ConfigError, match="was imported: its collection cannot go on"):
        check_same_collection(described(), tmp_path, {"provenance": {"imported_from": "minari"}})


def test_a_collection_goes_on_in_the_engine_that_it_was_begun_in(described, tmp_path):
    begun = {"provenance": described("engine=mujoco")}
    check_same_collection(described("engine=mujoco"), tmp_path, begun)
    for given in (["engine=sapien"], ["engine=mujoco", "engine.substeps=3"]):
        with pytest.raises(ConfigError, match="another engine"):
            check_same_collection(described(*given), tmp_path, begun)
    begun["provenance"]["engine"] = {"_target_": "torchgrasp.sim.MujocoEngine"}  # that has the defaults
    check_same_collection(described("engine=mujoco"), tmp_path, begun)
    older = {"provenance": {name: each for name, each in described().items() if name != "engine"}}
    check_same_collection(described(), tmp_path, older)
    with pytest.raises(ConfigError, match="another engine"):
        check_same_collection(described("engine=mujoco"), tmp_path, older)


def test_training_takes_another_seed_but_no_other_observations(described, tmp_path):
    card = {"provenance": described()}
    check_usable(described("seed=5", "objects.num_objects=9"), tmp_path, card)
    check_usable(described("num_points=40"), tmp_path, {"provenance": {}})  # nobody told
    for given, told in (("num_points=40", "transforms"), ("env.horizon=7", "horizon")):
        with pytest.raises(ConfigError, match=f"with another {told}: configure that as .*card.json tells"):
            check_usable(described(given), tmp_path, card)


def with_fov(told):
    """As cards and runs of version 0.1 tell it: transforms have the camera's field of view alone."""
    transforms = {name: dict(each) for name, each in told["transforms"].items()}
    for each in transforms.values():
        if each.pop("intrinsics", None) is not None:
            each["fov"] = told["camera"]["intrinsics"]["fov"]
    return {**told, "transforms": transforms}


def test_intrinsics_are_the_same_whether_by_themselves_or_by_their_field_of_view(described, tmp_path):
    now = described()
    assert with_fov(now) != now
    for ours in (now, with_fov(now)):
        for theirs in (now, with_fov(now)):
            check_usable(ours, tmp_path, {"provenance": theirs})
            check_same_collection(ours, tmp_path, {"provenance": theirs})
    other = described("camera.intrinsics.fov=0.7")
    with pytest.raises(ConfigError, match="with another transforms, camera"):
        check_usable(now, tmp_path, {"provenance": with_fov(other)})
    with pytest.raises(ConfigError, match="with another transforms"):
        check_usable(now, tmp_path, {"provenance": {**now, "transforms": ["points"]}})


def test_a_learner_collects_what_it_has_learned_from(composed, untrained):
    learner = [*("experiment=smoke", "demonstrations.kind=learner"), f"demonstrations.policy={untrained()}"]
    check_learner(composed(*learner, "seed=3"))
    with pytest.raises(ConfigError, match="learned with another transforms: configure it alike"):
        check_learner(composed(*learner, "transforms.sample.num_points=40"))
