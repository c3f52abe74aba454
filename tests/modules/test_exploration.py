"""DecayingUniformNoise: Sec. 6.4's ranges, only when exploring, reproducible and resumable."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import DecayingUniformNoise


def _noisy(noise, action=None, kind=ExplorationType.RANDOM):
    action = torch.zeros(2000, 6) if action is None else action
    with set_exploration_type(kind):
        return noise(TensorDict({"action": action}, action.shape[:-1]))["action"]


@pytest.mark.parametrize(
    ("steps", "metres", "degrees"), [(0, 0.03, 8.0), (50, 0.0175, 4.5), (100, 0.005, 1.0), (900, 0.005, 1.0)]
)
def test_range(steps, metres, degrees):
    noise = DecayingUniformNoise(100)
    noise.step(steps)
    reach = _noisy(noise).abs().amax(dim=0)
    expected = torch.tensor([metres] * 3 + [math.radians(degrees)] * 3)
    assert (reach <= expected + 1e-6).all()
    assert (reach > 0.98 * expected).all()


@pytest.mark.parametrize("kind", [ExplorationType.DETERMINISTIC, ExplorationType.MEAN, ExplorationType.MODE])
def test_silent_without_exploration(kind):
    assert torch.equal(_noisy(DecayingUniformNoise(100), kind=kind), torch.zeros(2000, 6))


def test_actions_stay_within_bounds():
    bound = torch.tensor(ACTION_BOUND)
    assert (_noisy(DecayingUniformNoise(100), bound.expand(100, 6)) <= bound).all()


def test_the_seed_decides_the_draws_and_the_state_dict_carries_the_range():
    first, second = DecayingUniformNoise(100, seed=3), DecayingUniformNoise(100, seed=3)
    other = DecayingUniformNoise(100, seed=4)
    drawn = _noisy(first)
    assert torch.equal(drawn, _noisy(second))
    assert not torch.equal(drawn, _noisy(other))
    first.step(40)
    second.load_state_dict(first.state_dict())
    assert torch.equal(second.half_range, first.half_range)


def test_draws_belong_to_the_moment_whatever_stands_beside_it():
    noise = DecayingUniformNoise(100)
    moment = {"world": torch.arange(4)[:, None], "episode": torch.ones(4, 1, dtype=torch.int64)}
    td = TensorDict({**moment, "time_left": torch.full((4, 1), 0.5), "action": torch.zeros(4, 6)}, [4])
    with set_exploration_type(ExplorationType.RANDOM):
        together, alone = noise(td.clone())["action"], noise(td[2:3].clone())["action"]
    assert torch.equal(together[2:3], alone)


def test_counter_travels_with_the_weights():
    assert "steps" in TensorDict.from_module(DecayingUniformNoise(100))


def test_other_keys_and_sizes():
    noise = DecayingUniformNoise(1, start=[1.0], end=[0.5], action_bound=[0.1], action_key=("agent", "u"))
    with set_exploration_type(ExplorationType.RANDOM):
        td = noise(TensorDict({"agent": {"u": torch.zeros(50, 1)}}, [50]))
    assert td["agent", "u"].abs().amax() == pytest.approx(0.1)


def test_wrong_options_are_refused():
    with pytest.raises(ConfigError, match="-1"):
        DecayingUniformNoise(-1)
    with pytest.raises(ConfigError, match="component"):
        DecayingUniformNoise(1, start=[0.1])
    with pytest.raises(ConfigError, match=r"action_bound=2\.0"):
        DecayingUniformNoise(1, action_bound=2.0)
