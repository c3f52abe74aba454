"""Updates of critic, targets and actor on networks of one to four numbers, worked out by hand."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate


class Scaled(nn.Module):
    """π(s) = w s."""

    def __init__(self, weight):
        super().__init__()
        self.weight = nn.Parameter(torch.tensor(weight))

    def forward(self, state):
        return self.weight * state


class Linear(nn.Module):
    """Q_i(s, a) = u_i s + v_i a."""

    def __init__(self, of_state, of_action):
        super().__init__()
        self.of_state = nn.Parameter(torch.tensor(of_state))
        self.of_action = nn.Parameter(torch.tensor(of_action))

    def forward(self, state, action):
        return self.of_state * state + self.of_action * action


@pytest.fixture
def loss():
    actor = TensorDictModule(Scaled(0.5), ["s"], ["action"])
    critic = TensorDictModule(Linear([1.0, 2.0], [3.0, 1.0]), ["s", "action"], ["state_action_value"])
    loss = GraspTD3BCLoss(
        actor,
        critic,
        bc_weight=0.2,
        aux_weight=0.0,
        policy_noise=0.0,
        action_bound=[10.0],
        distance=lambda expert, action: (expert - action).abs().squeeze(-1),
    )
    return loss.make_value_estimator(gamma=0.5)


@pytest.fixture
def batch():
    """A step that goes on, and one that terminated; the expert would do 2 and -1."""
    return TensorDict(
        {
            "s": torch.tensor([[1.0], [2.0]]),
            "action": torch.tensor([[1.0], [-1.0]]),
            "expert_action": torch.tensor([[2.0], [-1.0]]),
            "next": {
                "s": torch.tensor([[2.0], [1.0]]),
                "reward": torch.tensor([[0.5], [1.0]]),
                "terminated": torch.tensor([[False], [True]]),
            },
        },
        [2],
    )


def test_two_updates_by_hand(loss, batch):
    """Adam with lr 0.1, β = (0.9, 0.999), ε = 1e-8; targets with τ = 0.1 and copies every 2 updates.

    Critic, first update. Weights u = (1, 2), v = (3, 1).
      Row 1: s = 1, a = 1: Q = (4, 3). Next s' = 2, a' = 0.5 * 2 = 1: Q' = (1*2 + 3*1, 2*2 + 1*1) = (5, 5).
             y = 0.5 + 0.5 * 5 = 3. Errors (1, 0).
      Row 2: s = 2, a = -1: Q = (2 - 3, 4 - 1) = (-1, 3). Terminated: y = 1. Errors (-2, 2).
      Loss = mean of 1/2 (1 + 0), 1/2 (4 + 4) = (0.5 + 4) / 2 = 2.25.
      Gradients, mean of error times input: u: ((1*1 - 2*2) / 2, (0 + 2*2) / 2) = (-1.5, 2);
                                            v: ((1*1 + 2*1) / 2, (0 - 2*1) / 2) = (1.5, -1).
      Adam's first step is lr times the sign (ε aside): u = (1.1, 1.9), v = (2.9, 1.1).
    Targets: the first head follows by 0.1: u = 1 + 0.1 * 0.1 = 1.01, v = 3 - 0.1 * 0.1 = 2.99. The other set
      waits: u2 = 2, v2 = 1. The actor has not moved: its target stays 0.5.

    Actor, first update. w = 0.5, Q1 = 1.1 s + 2.9 w s.
      L_BC: actions 0.5 and 1; |2 - 0.5| = 1.5 and |-1 - 1| = 2: mean 1.75; its gradient in w
            (-1 * 1 + 1 * 2) / 2 = 0.5.
      L_DDPG: Q1 = 1.1 + 1.45 = 2.55 and 2.2 + 2.9 = 5.1: -3.825; its gradient -2.9 * (1 + 2) / 2 = -4.35.
      0.2 * 1.75 = 0.35, 0.8 * -3.825 = -3.06; gradient 0.2 * 0.5 - 0.8 * 4.35 = -3.38. w = 0.5 + 0.1 = 0.6.

    Critic, second update. Targets: a' = 0.5 * s' = 1; Q1' = 1.01 * 2 + 2.99 = 5.01, Q2' = 2 * 2 + 1 = 5.
      y = 0.5 + 0.5 * 5 = 3 again, and 1.
      Row 1: Q = (1.1 + 2.9, 1.9 + 1.1) = (4, 3): errors (1, 0).
      Row 2: Q = (2.2 - 2.9, 3.8 - 1.1) = (-0.7, 2.7): errors (-1.7, 1.7).
      Loss = (0.5 + 2.89) / 2 = 1.695.
      u: ((1 - 3.4) / 2, (0 + 3.4) / 2) = (-1.2, 1.7). v: ((1 + 1.7) / 2, (0 - 1.7) / 2) = (1.35, -0.85).
      Adam, per weight with gradients g then h: m = 0.1 (0.9 g + h) / (1 - 0.81),
      n = 0.001 (0.999 g² + h²) / (1 - 0.998001), step 0.1 m / √n:
        u1: m = 0.1 * (-1.35 - 1.2) / 0.19 = -1.342105, n = (2.24775 + 1.44) / 1.999 = 1.844797;
            √n = 1.358233: step -0.0988126, u1 = 1.1988126.
        u2: m = 0.1 * (1.8 + 1.7) / 0.19 = 1.842105, n = (3.996 + 2.89) / 1.999 = 3.444722;
            √n = 1.855996: step 0.0992516, u2 = 1.8007484.
        v1: m = 0.1 * (1.35 + 1.35) / 0.19 = 1.421053, n = (2.24775 + 1.8225) / 1.999 = 2.036143;
            √n = 1.426935: step 0.0995878, v1 = 2.8004122.
        v2: m = 0.1 * (-0.9 - 0.85) / 0.19 = -0.921053, n = (0.999 + 0.7225) / 1.999 = 0.861181;
            √n = 0.927998: step -0.0992516, v2 = 1.1992516.
    Targets: u1 = 1.01 + 0.1 * (1.1988126 - 1.01) = 1.0288813, v1 = 2.99 + 0.1 * (2.8004122 - 2.99) =
      2.9710412; the other set is copied, u2 = 1.8007484, v2 = 1.1992516; the actor 0.5 + 0.1 * 0.1 = 0.51.
    """
    targets = StaggeredTargetUpdate(loss, tau=0.1, period=2)
    actor, critic = loss.actor_network_params["module"], loss.critic_network_params["module"]
    follows = loss.target_critic_network_params["module"]
    copied = loss.target_delayed_critic_network_params["module"]
    critic_adam = torch.optim.Adam(loss.critic_network_params.parameters(), lr=0.1)
    actor_adam = torch.optim.Adam(loss.actor_network_params.parameters(), lr=0.1)

    out = _descend(critic_adam, loss.critic_loss(batch))
    assert out == pytest.approx({"loss_qvalue": 2.25}, abs=1e-6)
    _expect(critic, of_state=[1.1, 1.9], of_action=[2.9, 1.1])
    targets.step()
    assert follows["of_state"][0].item() == pytest.approx(1.01, abs=1e-6)
    assert follows["of_action"][0].item() == pytest.approx(2.99, abs=1e-6)
    _expect(copied, of_state=[1.0, 2.0], of_action=[3.0, 1.0])
    _expect(loss.target_actor_network_params["module"], weight=0.5)

    out = _descend(actor_adam, loss.actor_loss(batch))
    assert out == pytest.approx({"loss_actor_bc": 0.35, "loss_actor_ddpg": -3.06}, abs=1e-6)
    _expect(actor, weight=0.6)

    out = _descend(critic_adam, loss.critic_loss(batch))
    assert out == pytest.approx({"loss_qvalue": 1.695}, abs=1e-6)
    _expect(critic, of_state=[1.1988126, 1.8007484], of_action=[2.8004122, 1.1992516])
    targets.step()
    assert follows["of_state"][0].item() == pytest.approx(1.0288813, abs=1e-6)
    assert follows["of_action"][0].item() == pytest.approx(2.9710412, abs=1e-6)
    _expect(copied, of_state=[1.1988126, 1.8007484], of_action=[2.8004122, 1.1992516])
    _expect(loss.target_actor_network_params["module"], weight=0.51)


def test_the_actors_gradient_by_hand(loss, batch):
    """With SGD the size shows too: w = 0.5 + 0.1 * 3.5 where Q1 still has v = 3.

    Gradient 0.2 * 0.5 - 0.8 * 3 * 1.5 = -3.5.
    """
    StaggeredTargetUpdate(loss)
    _descend(torch.optim.SGD(loss.actor_network_params.parameters(), lr=0.1), loss.actor_loss(batch))
    _expect(loss.actor_network_params["module"], weight=0.5 + 0.1 * 3.5)


def _descend(optimizer, terms):
    losses = {key: value for key, value in terms.items() if key.startswith("loss_")}
    optimizer.zero_grad()
    sum(losses.values()).backward()
    optimizer.step()
    return {key: value.item() for key, value in losses.items()}


def _expect(params, **weights):
    for name, expected in weights.items():
        torch.testing.assert_close(params[name].data, torch.tensor(expected), atol=1e-6, rtol=0)
