import pickle

import numpy as np
import pytest

from torchgrasp.errors import ConfigError
from torchgrasp.objects import MixtureObjects, ProceduralObjects


@pytest.fixture
def parts(cache_dir):
    options = {"num_grasps": 100, "cache_dir": cache_dir}
    return {
        "boxes": ProceduralObjects("train", num_objects=3, families=["box"], **options),
        "cans": ProceduralObjects("train", num_objects=1, families=["cylinder"], **options),
    }


def test_a_plain_set_draws_uniformly(parts):
    draws = [parts["boxes"].draw(np.random.default_rng(seed)) for seed in range(300)]
    assert draws == [int(np.random.default_rng(seed).integers(3)) for seed in range(300)]
    assert np.bincount(draws).min() > 70


def test_a_mixture_draws_a_set_by_weight_and_then_uniformly(parts):
    mixture = MixtureObjects(parts, weights={"boxes": 1, "cans": 3})
    rng = np.random.default_rng(0)
    shares = np.bincount([mixture.draw(rng) for _ in range(4000)], minlength=4) / 4000
    assert shares == pytest.approx((1 / 12, 1 / 12, 1 / 12, 3 / 4), abs=0.025)
    rng = np.random.default_rng(0)
    equal = np.bincount([MixtureObjects(parts).draw(rng) for _ in range(4000)], minlength=4) / 4000
    assert equal == pytest.approx((1 / 6, 1 / 6, 1 / 6, 1 / 2), abs=0.03)


def test_objects_are_the_members_own_under_the_sets_names(parts):
    mixture = MixtureObjects(parts)
    mixture.prepare(progress=False)
    assert mixture.names[2:] == ("boxes/box-train-00002", "cans/cylinder-train-00000")
    assert [item.name for item in mixture] == list(mixture.names)
    assert mixture[3].content_hash == parts["cans"][0].content_hash
    assert mixture.licence(3) == parts["cans"].licence(0)
    assert not mixture.missing()
    assert pickle.loads(pickle.dumps(mixture))[-1].name == mixture.names[-1]


def test_wrong_mixtures_are_refused(parts):
    with pytest.raises(ConfigError, match="sets is empty"):
        MixtureObjects({})
    with pytest.raises(ConfigError, match="boxes, cans"):
        MixtureObjects(parts, weights={"boxes": 1})
    with pytest.raises(ConfigError, match=r"^weights\['cans'\]=0"):
        MixtureObjects(parts, weights={"boxes": 1, "cans": 0})
