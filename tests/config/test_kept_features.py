"""replay.keep_features: which networks learn on kept features, and that they learn the same."""

import pytest
import torch

from torchgrasp.config import make_actor_critic
from torchgrasp.config.kept_features import keep_features
from torchgrasp.config.networks import make_networks
from torchgrasp.config.transition_storage import make_experience
from torchgrasp.data import DemonstrationSource
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import seed_everything

POINTS = {"points": (38, 4), "time_left": (1,), "table_plane": (4,), "wrist_angle": (1,)}
FROZEN = ["experiment=smoke", "model.actor.freeze_encoder=true", "model.critic.freeze_encoder=true"]
LATE = [*FROZEN, "model.critic.fusion=late"]
MIRROR = "replay.augment={_target_: torchgrasp.transforms.RandomMirror}"


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        (["experiment=smoke"], set()),
        (FROZEN, {"actor"}),
        (LATE, {"actor", "critic"}),
        ([*LATE, "replay.keep_features=[critic]"], {"critic"}),
        ([*LATE, "replay.keep_features=null"], set()),
    ],
)
def test_who_learns_on_kept_features(composed, given, kept):
    cfg = composed(*given)
    networks = make_networks(cfg.model)
    found = keep_features(cfg, networks)
    assert set(found.encoders) == kept
    for name, each in found.networks.items():
        assert ("points" not in each.in_keys) == (name in kept)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            [*FROZEN, "replay.keep_features=[critic]"],
            "the critic's encoder sees the action .*with fusion=late",
        ),
        (["experiment=smoke", "replay.keep_features=[actor]"], "the actor's encoder learns"),
        ([*LATE, "replay.keep_features=[actr]"], "give auto, null, or a list of actor, critic"),
    ],
)
def test_what_cannot_be_kept_is_refused(composed, given, words):
    cfg = composed(*given)
    with pytest.raises(ConfigError, match=words):
        keep_features(cfg, make_networks(cfg.model))


def test_an_augmentation_that_tells_no_views_is_refused(composed):
    scaled = "{_target_: torchrl.envs.ObservationNorm, loc: 0.0, scale: 2.0, in_keys: [points]}"
    cfg = composed(*LATE, f"replay.augment={scaled}")
    with pytest.raises(ConfigError, match=r"replay\.augment changes 'points', of which features are kept"):
        make_experience(cfg, make_networks(cfg.model), POINTS, own="online")
    cfg = composed(*LATE, "replay.augment={_target_: torchgrasp.transforms.HindsightGoal}")
    make_experience(cfg, make_networks(cfg.model), POINTS, own="online")


@pytest.mark.parametrize(("dtype", "error"), [("float32", 2e-6), ("float16", 1e-3)])
def test_updates_are_those_of_features_computed_anew(composed, demonstrations, untrained, dtype, error):
    """Actor and critic on mirrored batches: the same losses, and with them the same weights."""
    init = untrained("model.critic.fusion=late")
    told = {}
    for kept in ("auto", "null"):
        cfg = composed(
            *LATE, MIRROR, f"init={init}", f"replay.keep_features={kept}", f"replay.feature_dtype={dtype}"
        )
        seed_everything(0)
        learner = make_actor_critic(cfg)
        experience = make_experience(cfg, learner.networks, POINTS, own="online")
        experience.make_buffer([DemonstrationSource("expert", demonstrations, "successful")])
        experience.load_demonstrations()
        experience.draw_demonstrations()
        learner.set_rate(1e-4)
        torch.manual_seed(1)
        for _ in range(3):
            batch = experience.sample()
            assert ("points" in batch) == (kept == "null")
            learner.update_critic(batch)
            learner.update_actor(batch)
        told[kept] = learner.fetch_terms()
    assert told["auto"].keys() == told["null"].keys()
    for name, value in told["null"].items():
        assert told["auto"][name] == pytest.approx(value, rel=error, abs=error), name


def test_features_of_weights_that_a_checkpoint_brings_are_taken_up(composed, demonstrations, untrained):
    """As a run is resumed: networks, then buffer; another encoder's features are refused."""
    cfg = composed(*LATE, f"init={untrained('model.critic.fusion=late')}")
    states = []
    for seed in (0, 1):
        seed_everything(seed)
        learner = make_actor_critic(cfg)
        if seed:
            for each in learner.networks.values():
                for value in each.parameters():
                    value.data.add_(0.1)
        experience = make_experience(cfg, learner.networks, POINTS, own="online")
        experience.make_buffer([DemonstrationSource("expert", demonstrations, "successful")])
        if not seed:
            experience.load_demonstrations()
            states = [learner.state_dict(), experience.buffer.state_dict()]
    with pytest.raises(CheckpointError, match="of another encoder"):
        experience.buffer.load_state_dict(states[1])
    learner.load_state_dict(states[0])
    experience.buffer.load_state_dict(states[1])
    experience.draw_demonstrations()
    batch = experience.sample()
    frozen = {name: value.clone() for name, value in learner.networks["critic"].state_dict().items()}
    learner.update_critic(batch)
    after = learner.networks["critic"].state_dict()
    kept = {name for name, value in frozen.items() if torch.equal(after[name], value)}
    assert kept == {name for name in frozen if ".encoder." in name} | {"module.bound"}
