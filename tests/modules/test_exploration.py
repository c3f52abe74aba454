"""DecayingUniformNoise: Sec. 6.4's ranges, only when exploring, reproducible and resumable."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import DecayingUniformNoise, ExploringStep, NearbyActions


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


def _moments(episodes: int, step: int, horizon: int = 10) -> TensorDict:
    """A step (episodes) of as many episodes."""
    moment = {
        "world": torch.zeros(episodes, 1, dtype=torch.int64),
        "episode": torch.arange(episodes)[:, None],
    }
    left = torch.full((episodes, 1), 1 - step / horizon)
    return TensorDict({**moment, "time_left": left, "action": torch.zeros(episodes, 6)}, [episodes])


def _changes(step: ExploringStep, episodes: int = 400) -> torch.Tensor:
    """Changes (episodes, 10, 6) over all steps."""
    with set_exploration_type(ExplorationType.RANDOM):
        return torch.stack([step(_moments(episodes, t))["action"] for t in range(10)], dim=1)


def test_one_step_of_each_episode_is_changed():
    changed = _changes(ExploringStep(horizon=10, first=4)).any(-1)
    assert (changed.sum(-1) == 1).all() and not changed[:, :4].any()
    assert (changed.sum(0)[4:] > 30).all()  # of 400 / 6 each


def test_changes_have_every_size_up_to_the_reach():
    units = _changes(ExploringStep(horizon=10, reach=0.5)) / torch.tensor(ACTION_BOUND)
    sizes = units.sum(1).norm(dim=-1)
    assert sizes.max() <= 0.5 + 1e-6 and sizes.min() < 0.05 and sizes.mean() == pytest.approx(0.25, abs=0.03)


def test_the_episode_decides_and_the_seed():
    first, again, other = (_changes(ExploringStep(horizon=10, seed=seed)) for seed in (0, 0, 1))
    assert torch.equal(first, again) and not torch.equal(first, other)


def test_changed_actions_stay_within_their_bounds():
    bound = torch.tensor(ACTION_BOUND)
    assert (_changes(ExploringStep(horizon=10, reach=50.0)).abs() <= bound).all()


def test_nothing_is_changed_without_exploration():
    step = ExploringStep(horizon=10)
    for kind in (ExplorationType.DETERMINISTIC, ExplorationType.MODE):
        with set_exploration_type(kind):
            assert not any(step(_moments(50, t))["action"].any() for t in range(10))


@pytest.mark.parametrize("wrong", [{"horizon": 0}, {"horizon": 5, "first": 5}, {"horizon": 5, "reach": -1.0}])
def test_an_exploring_step_that_cannot_be_is_refused(wrong):
    with pytest.raises(ConfigError, match=next(reversed(wrong))):
        ExploringStep(**wrong)


def _proposals(nearby: NearbyActions, step: int, episodes: int = 200) -> torch.Tensor:
    with set_exploration_type(ExplorationType.RANDOM):
        return nearby(_moments(episodes, step))["tried_action"]


def test_actions_near_the_last_one_are_proposed_its_own_first():
    nearby = NearbyActions(horizon=10, num_tries=5, reach=0.5)
    assert not _proposals(nearby, 8).any()
    units = _proposals(nearby, 9) / torch.tensor(ACTION_BOUND)
    sizes = units.norm(dim=-1)
    assert units.shape == (200, 5, 6) and not units[:, 0].any()
    assert sizes[:, 1:].max() <= 0.5 + 1e-6 and sizes[:, 1:].mean() == pytest.approx(0.25, abs=0.03)


def test_proposals_follow_from_the_moment_and_the_seed():
    first, again, other = (_proposals(NearbyActions(horizon=10, seed=seed), 9) for seed in (0, 0, 1))
    assert torch.equal(first, again) and not torch.equal(first, other)
    whole, alone = _proposals(NearbyActions(horizon=10), 9), NearbyActions(horizon=10)
    with set_exploration_type(ExplorationType.RANDOM):
        assert torch.equal(alone(_moments(200, 9)[7:8])["tried_action"], whole[7:8])


def test_proposals_stay_within_the_bounds_and_leave_the_action_alone():
    state = _moments(50, 9).set("action", 0.9 * torch.tensor(ACTION_BOUND).expand(50, 6))
    before = state["action"].clone()
    with set_exploration_type(ExplorationType.RANDOM):
        tried = NearbyActions(horizon=10, reach=3.0)(state)["tried_action"]
    assert (tried.abs() <= torch.tensor(ACTION_BOUND)).all() and torch.equal(state["action"], before)


def test_nothing_is_proposed_without_exploration():
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert "tried_action" not in NearbyActions(horizon=10)(_moments(2, 9))


@pytest.mark.parametrize(
    "wrong", [{"horizon": 0}, {"horizon": 5, "num_tries": 0}, {"horizon": 5, "reach": -1.0}]
)
def test_proposals_that_cannot_be_are_refused(wrong):
    with pytest.raises(ConfigError, match=next(reversed(wrong))):
        NearbyActions(**wrong)
