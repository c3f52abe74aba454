"""The target ahead: discounts, steps, ends and estimators, by hand and beside TorchRL's TD3Loss."""

from copy import deepcopy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded, LazyTensorStorage, MultiStep, TensorDictReplayBuffer
from torchrl.envs import MultiStepTransform
from torchrl.modules import MLP, ValueOperator
from torchrl.objectives import SoftUpdate, TD3Loss, ValueEstimators
from torchrl.objectives.value import TD0Estimator, TD1Estimator, TDLambdaEstimator

from torchgrasp.errors import ConfigError
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate

SPEC = Bounded(-1.0, 1.0, (1,))


class Ten(nn.Linear):
    """Q = 10 everywhere."""

    def forward(self, observation, action):
        return 10 + 0 * super().forward(observation)


def make_ours(critics):
    actor = TensorDictModule(nn.Linear(1, 1), ["observation"], ["action"])
    loss = GraspTD3BCLoss(actor, critics, bc_weight=0.0, policy_noise=0.0, action_spec=SPEC)
    StaggeredTargetUpdate(loss)
    return loss


@pytest.fixture
def ten():
    critic = TensorDictModule(Ten(1, 1), ["observation", "action"], ["state_action_value"])
    return make_ours(critic).make_value_estimator(gamma=0.5)


@pytest.fixture
def pair():
    """Ours and TorchRL's on copies of the same two critics."""
    torch.manual_seed(0)
    critics = [ValueOperator(MLP(2, 1, num_cells=[8]), ["observation", "action"]) for _ in range(2)]
    ours = make_ours(deepcopy(critics))
    theirs = TD3Loss(deepcopy(ours.actor_network), critics, action_spec=SPEC, policy_noise=0.0)
    SoftUpdate(theirs, tau=0.5)
    return ours, theirs


def make_batch(*shape):
    """Zeros, but for the observations."""
    zeros, no = torch.zeros(*shape, 1), torch.zeros(*shape, 1, dtype=torch.bool)
    observed = torch.randn(2, *shape, 1, generator=torch.Generator().manual_seed(0))
    following = {"observation": observed[1], "reward": zeros, "done": no, "terminated": no.clone()}
    return TensorDict({"observation": observed[0], "action": zeros, "next": following}, shape)


def make_episodes():
    """(8, 5) steps with rewards, ends and truncations."""
    batch, generator = make_batch(8, 5), torch.Generator().manual_seed(1)
    batch["next", "reward"] = torch.randn(8, 5, 1, generator=generator)
    batch["next", "terminated"] = torch.rand(8, 5, 1, generator=generator) < 0.2
    batch["next", "done"] = batch["next", "terminated"] | (torch.rand(8, 5, 1, generator=generator) < 0.2)
    batch["next", "done"][:, -1] = True
    return batch


def assert_same_target(pair, batch):
    ours, theirs = pair
    mine, other = batch.clone(), batch.clone()
    found, expected = ours.critic_loss(mine), theirs(other)
    torch.testing.assert_close(found["target_value"], expected["target_value"].mean())
    torch.testing.assert_close(mine["td_error"].square(), other["td_error"])


@pytest.mark.parametrize("shape", [(3,), (3, 1)])
def test_the_value_after_n_steps_counts_gamma_to_the_n(ten, shape):
    """Gamma 0.5, values of 10, no reward: 1, 2 and 3 steps ahead they are worth 5, 2.5 and 1.25."""
    batch = make_batch(3).set("steps_to_next_obs", torch.tensor([1, 2, 3]).reshape(shape))
    out = ten.critic_loss(batch)
    torch.testing.assert_close(batch["td_error"], torch.tensor([5.0, 7.5, 8.75]))
    assert out["target_value"].item() == pytest.approx(8.75 / 3)


def test_the_number_of_steps_has_a_key_of_its_own(ten):
    ten.set_keys(steps_to_next_obs=("info", "steps"))
    batch = make_batch(2).set(("info", "steps"), torch.tensor([[1], [3]]))
    ten.critic_loss(batch)
    torch.testing.assert_close(batch["td_error"], torch.tensor([5.0, 8.75]))
    assert ("info", "steps") in ten.in_keys


def test_without_steps_it_is_one(ten):
    batch = make_batch(2, 3)
    ten.critic_loss(batch)
    torch.testing.assert_close(batch["td_error"], torch.full((2, 3), 5.0))


def test_ends_by_hand(ten):
    """What terminated is worth its reward, whatever stands after it; what was truncated goes on."""
    batch = make_batch(3)
    batch["next", "reward"] = torch.tensor([[0.0], [1.0], [0.5]])
    batch["next", "terminated"] = torch.tensor([[False], [True], [True]])
    batch["next", "done"] = torch.ones(3, 1, dtype=torch.bool)
    batch["next", "observation"][2] = torch.nan
    ten.critic_loss(batch)
    torch.testing.assert_close(batch["td_error"], torch.tensor([5.0, 9.0, 9.5]))


@pytest.mark.parametrize("n_steps", [1, 2, 3])
def test_multi_step_data_as_td3_loss_reads_it(pair, n_steps):
    for loss in pair:
        loss.make_value_estimator(gamma=0.5)
    steps = MultiStep(gamma=0.5, n_steps=n_steps)(make_episodes())
    assert steps["steps_to_next_obs"].max() == n_steps
    assert_same_target(pair, steps)
    assert_same_target(pair, steps.reshape(-1))


def test_multi_step_data_of_a_buffer(pair):
    for loss in pair:
        loss.make_value_estimator(gamma=0.5)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(40), batch_size=16)
    buffer.append_transform(MultiStepTransform(n_steps=3, gamma=0.5))
    for steps in make_episodes().unbind(0):
        buffer.extend(steps)
    assert_same_target(pair, buffer.sample())


ESTIMATORS = [
    ("td0", TD0Estimator, {}),
    ("TD1", TD1Estimator, {}),
    (ValueEstimators.TDLambda, TDLambdaEstimator, {"lmbda": 0.5}),
    (ValueEstimators.TD0, TD0Estimator, {"average_rewards": True}),
    (TD0Estimator, TD0Estimator, {"value_network": None}),
]


@pytest.mark.parametrize(("value_type", "kind", "options"), ESTIMATORS)
def test_every_estimator_of_td3_loss(pair, value_type, kind, options):
    for loss in pair:
        loss.make_value_estimator(value_type, gamma=0.7, **options)
        loss.value_estimator.set_keys(value="state_action_value")  # TorchRL leaves it out for a class
        assert type(loss.value_estimator) is kind
    assert pair[0].gamma == pytest.approx(0.7)
    assert_same_target(pair, make_episodes())


def test_an_estimator_of_ones_own(pair):
    for loss in pair:
        own = TD1Estimator(gamma=0.6, value_network=None)
        own.set_keys(value="state_action_value")
        assert loss.make_value_estimator(own) is loss
        assert loss.value_estimator is own
    assert_same_target(pair, make_episodes())


def test_the_first_estimator_is_that_of_the_paper():
    critic = TensorDictModule(Ten(1, 1), ["observation", "action"], ["state_action_value"])
    loss = make_ours(critic)
    assert type(loss.value_estimator) is TD0Estimator and loss.value_type is ValueEstimators.TD0
    assert loss.gamma == pytest.approx(0.95)
    assert loss.make_value_estimator(gamma=0.5) is loss and loss.gamma == 0.5
    assert loss.make_value_estimator().gamma == pytest.approx(0.95)


def test_done_counts_where_an_estimator_reads_it(pair):
    """Beyond a truncation TD(1) does not look; where `done` is absent, only what terminated is done."""
    ours, _ = pair
    ours.make_value_estimator("td1")
    episodes = make_episodes()
    here, without = episodes.clone(), episodes.exclude(("next", "done"))
    for batch in (here, without):
        ours.critic_loss(batch)
    assert not torch.allclose(here["td_error"], without["td_error"])
    ended = episodes.clone()
    ended["next", "done"] = ended["next", "terminated"]
    ours.critic_loss(ended)
    torch.testing.assert_close(ended["td_error"], without["td_error"])


@pytest.mark.parametrize("before", [True, False])
def test_keys_reach_the_estimator(ten, before):
    names = {"reward": "r", "done": ("end", "d"), "terminated": "t", "state_action_value": "q"}
    if before:
        ten.set_keys(**names)
    ten.make_value_estimator("td1")
    if not before:
        ten.set_keys(**names)
    found = ten.value_estimator.tensor_keys
    assert (found.value, found.reward, found.done, found.terminated) == ("q", "r", ("end", "d"), "t")


def test_value_loss_is_eq_3_as_one_number(ten):
    batch = make_batch(4)
    value, figures = ten.value_loss(batch)
    expected = ten.critic_loss(batch.clone())
    torch.testing.assert_close(value, expected["loss_qvalue"])
    assert value.requires_grad and not any(each.requires_grad for each in figures.values())
    torch.testing.assert_close(figures["target_value"], expected["target_value"])


def test_no_checkpoint_holds_the_estimator(ten):
    assert not any("estimator" in name for name in ten.state_dict())
    assert not any("estimator" in name for name, _ in ten.named_buffers())
    assert ten.to(torch.bfloat16).value_estimator.gamma.dtype == torch.float32


@pytest.mark.parametrize("value_type", [ValueEstimators.GAE, "vtrace", "no such thing", 5, int])
def test_other_estimators_are_refused_as_td3_loss_refuses_them(ten, value_type):
    for kind in (ConfigError, NotImplementedError):
        with pytest.raises(kind, match="choose one of TD0, TD1, TDLambda"):
            ten.make_value_estimator(value_type)
    assert ten.gamma == 0.5


def test_wrong_options_of_an_estimator_are_refused(ten):
    with pytest.raises(ConfigError, match="speed"):
        ten.make_value_estimator(speed=3)
    for gamma in (1.5, -0.1, "0.9"):
        with pytest.raises(ConfigError, match=f"gamma={gamma!r}"):
            ten.make_value_estimator(gamma=gamma)
