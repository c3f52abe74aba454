"""KeepFeatures in buffers, environments and by itself; whose features are whose."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, PendulumEnv, TransformedEnv, UnsqueezeTransform, check_env_specs

from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.transforms import KeepFeatures, RandomMirror


class Counting(nn.Module):
    """A linear encoder that counts the states that it was given."""

    def __init__(self):
        super().__init__()
        self.layer, self.count = nn.Linear(3, 5), 0

    def forward(self, values):
        self.count += values[..., 0].numel()
        return self.layer(values).relu()


def make_encoder(seed=0):
    torch.manual_seed(seed)
    return TensorDictModule(Counting(), ["x"], [("features", "it")]).requires_grad_(False)


def make_buffer(encoder, **options):
    transform = KeepFeatures(encoder, **options)
    return TensorDictReplayBuffer(storage=LazyTensorStorage(100), batch_size=8, transform=transform)


def make_steps(batch=2, length=6):
    """(B, T) steps in two episodes of three."""
    x = torch.rand(batch, length + 1, 3)
    after = x[:, 1:].clone()
    after[:, 2] = torch.rand(batch, 3)  # an end: the next row is another episode's first
    return TensorDict({"x": x[:, :-1], "next": {"x": after}}, [batch, length])


def test_a_buffer_keeps_the_features_of_each_state_and_encodes_it_once():
    encoder, steps = make_encoder(), make_steps()
    buffer = make_buffer(encoder, chunk_size=5)
    buffer.extend(steps.reshape(-1))
    assert encoder.module.count == 12 + 4  # each state, and where an episode or a row ends what follows
    batch = buffer.sample()
    assert encoder.module.count == 16
    for state in (batch, batch["next"]):
        torch.testing.assert_close(state["features", "it"], encoder.module(state["x"]))


def test_equal_states_in_a_row_are_encoded_once():
    """As of actions that were tried in one state, and lead to one next state."""
    encoder, states = make_encoder(), torch.rand(2, 3).repeat_interleave(4, 0)
    written = KeepFeatures(encoder)(TensorDict({"x": states, "next": {"x": states.flip(0)}}, [8]))
    assert encoder.module.count == 2 + 2
    torch.testing.assert_close(written["features", "it"], encoder.module(states))
    torch.testing.assert_close(written["next", "features", "it"], encoder.module(states.flip(0)))


def test_batches_without_features_get_them_and_others_keep_theirs():
    encoder, steps = make_encoder(), make_steps()
    transform = KeepFeatures(encoder)
    made = transform(steps.clone())
    assert made["next", "features", "it"].shape == (2, 6, 5)
    made["features", "it"].zero_()
    assert not transform(made)["features", "it"].any()
    alone = transform(steps[0, 0].exclude("next"))
    torch.testing.assert_close(alone["features", "it"], encoder.module(steps[0, 0]["x"]))
    del made["next", "features"]
    assert transform(made)["next", "features", "it"].any()


def test_specs_in_an_environment():
    torch.manual_seed(0)
    encoder = TensorDictModule(nn.Linear(1, 4), ["th"], ["feature"]).requires_grad_(False)
    angles = ["th", "thdot"]
    column = UnsqueezeTransform(-1, in_keys=angles, in_keys_inv=angles)
    env = TransformedEnv(PendulumEnv(), Compose(column, KeepFeatures(encoder)))
    check_env_specs(env)
    steps = env.rollout(3)
    torch.testing.assert_close(steps["next", "feature"], encoder.module(steps["next", "th"]))


def test_a_buffer_that_another_encoder_filled_is_refused(tmp_path):
    first = make_buffer(make_encoder())
    first.extend(make_steps().reshape(-1))
    first.dumps(tmp_path)
    for seed in (0, 1):
        second = make_buffer(make_encoder(seed))
        second.extend(make_steps().reshape(-1))  # so that there is a storage to load into
        if seed:
            with pytest.raises(CheckpointError, match="features that were kept are of another encoder"):
                second.loads(tmp_path)
        else:
            second.loads(tmp_path)
            assert torch.equal(second[:]["features", "it"], first[:]["features", "it"])


def test_an_encoder_that_changes_is_refused():
    encoder = make_encoder()
    buffer = make_buffer(encoder)
    with torch.no_grad():
        encoder.module.layer.weight.mul_(2.0)  # nothing is kept yet
    buffer.extend(make_steps().reshape(-1))
    state = encoder.state_dict()
    encoder.load_state_dict(state)
    buffer.extend(make_steps().reshape(-1))
    with torch.no_grad():
        encoder.module.layer.weight.mul_(2.0)
    with pytest.raises(ConfigError, match="encoder has changed"):
        buffer.extend(make_steps().reshape(-1))


def test_an_encoder_that_learns_is_refused():
    with pytest.raises(ConfigError, match=r"encoder has parameters that learn, such as module\.weight"):
        KeepFeatures(TensorDictModule(nn.Linear(3, 2), ["x"], ["y"]))


def test_states_without_what_the_encoder_reads_are_refused():
    with pytest.raises(ConfigError, match=r"KeepFeatures needs \['x'\]"):
        KeepFeatures(make_encoder())(TensorDict({}, [2]))


def test_the_view_that_a_mirror_draws_is_taken_of_those_kept():
    torch.manual_seed(0)
    network = nn.Sequential(nn.Flatten(-2), nn.Linear(12, 5))
    encoder = TensorDictModule(network, ["points"], ["feature"]).requires_grad_(False)
    state = {"points": torch.randn(64, 4, 3)}
    batch = TensorDict({**state, "next": {"points": torch.randn(64, 4, 3)}}, [64])
    mirror = RandomMirror(feature_keys=["feature", ("next", "feature")])
    kept = KeepFeatures(encoder, views=mirror.views)(batch.clone())
    assert kept["next", "feature"].shape == (64, 4, 5)
    out = mirror(kept)
    for each in (out, out["next"]):
        torch.testing.assert_close(each["feature"], network(each["points"]))
    assert (out["points"] != batch["points"]).any()
