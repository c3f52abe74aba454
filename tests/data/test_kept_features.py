"""Features in a MixtureReplayBuffer: stored once a state, next ones from the following row, in few bits."""

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn

from tests.data.rollouts import make_rollout
from torchgrasp.data import CompactTransitions, MixtureReplayBuffer
from torchgrasp.data.encodings import FeatureEncoding
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.transforms import KeepFeatures

KEY = ("features", "it")
ERROR = {"float32": 0.0, "float16": 2**-11, "bfloat16": 2**-8}


def make_features():
    torch.manual_seed(0)
    network = nn.Sequential(nn.Flatten(-2), nn.Linear(14 * 4, 6))
    return KeepFeatures(TensorDictModule(network, ["points"], [KEY]).requires_grad_(False))


def make_buffer(codec):
    return MixtureReplayBuffer(
        {"online": 200, "expert": 200}, {"online": 0.5, "expert": 0.5}, batch_size=64, codec=codec
    )


@pytest.mark.parametrize("dtype", ERROR)
def test_rollouts_and_rows_of_files_have_the_features_of_their_clouds(dtype):
    features = make_features()
    codec = CompactTransitions(features=features, feature_dtype=dtype)
    buffer, generator = make_buffer(codec), torch.Generator().manual_seed(0)
    for turn in range(5):
        buffer.extend(make_rollout(3, 7, generator=generator, first_state=1000 * turn), source="online")
        rows = CompactTransitions().encode(make_rollout(2, 5, generator=generator, first_state=1000 * turn))
        assert KEY not in rows.keys(True)
        buffer.extend_rows(rows, source="expert")
        batch = buffer.sample()
        for state in (batch, batch["next"]):
            expected = features.encode(state)[KEY]
            limit = ERROR[dtype] * expected.abs() + 1e-6
            assert state[KEY].dtype == torch.float32
            assert ((state[KEY] - expected).abs() <= limit).all()
    assert buffer.num_rows()["expert"] > 0


def test_clouds_that_nothing_else_reads_are_not_stored():
    codec = CompactTransitions(features=make_features(), drop_keys=["points"])
    buffer, generator = make_buffer(codec), torch.Generator().manual_seed(0)
    rollout = make_rollout(3, 7, generator=generator)
    whole = CompactTransitions(features=make_features()).encode(rollout)
    buffer.extend(rollout, source="online")
    buffer.extend_rows(CompactTransitions().encode(rollout), source="expert")
    batch = buffer.sample()
    assert "points" not in batch and "points" not in batch["next"]
    stored = buffer.state_dict()["_storage"]["rows"]
    for name in ("online", "expert"):
        assert torch.equal(stored[name]["features.it"], whole[KEY])
    assert codec.example_row({"points": (14, 4), "time_left": (1,)})[KEY].shape == (1, 6)


def test_the_buffers_state_holds_whose_features_they_are():
    first = make_buffer(CompactTransitions(features=make_features()))
    first.extend(make_rollout(3, 7, generator=torch.Generator().manual_seed(0)), source="online")
    state = first.state_dict()
    make_buffer(CompactTransitions(features=make_features())).load_state_dict(state)
    other = make_features()
    with torch.no_grad():
        next(other._encoder.parameters()).add_(1.0)
    with pytest.raises(CheckpointError, match="of another encoder"):
        make_buffer(CompactTransitions(features=other)).load_state_dict(state)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"points_key": None}, r"features and drop_keys name \['points'\]"),
        ({"drop_keys": ["time_left"]}, r"drop_keys=\['time_left'\]: drop what `features` reads"),
        ({"feature_dtype": "int8"}, "feature_dtype='int8' is unknown"),
    ],
)
def test_a_codec_that_cannot_make_its_features_is_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        CompactTransitions(features=make_features(), **options)


def test_features_beyond_float16_are_refused():
    with pytest.raises(ConfigError, match=r"'f' holds values .* too large"):
        FeatureEncoding("f", "float16").encode(torch.tensor([1e5]))
    assert FeatureEncoding("f", "bfloat16").encode(torch.tensor([1e5])).isfinite().all()
