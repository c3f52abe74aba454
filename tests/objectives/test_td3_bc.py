"""GraspTD3BCLoss: Eq. (3) to (5) by hand, who receives gradients, corner cases, foreign networks."""

import warnings
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded
from torchrl.modules import MLP, Actor, ValueOperator
from torchrl.objectives import SoftUpdate

from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GraspActor, GraspCritic, PointNet
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate

make_loss = partial(GraspTD3BCLoss, action_bound=ACTION_BOUND)


def _loss(actor, critic, **options):
    loss = make_loss(actor, critic, **options)
    StaggeredTargetUpdate(loss)
    return loss


def test_critic_terms_by_hand(constant_actor, constant_critic, batch):
    """Both targets 0.4 and 0.2, so y = 0.19 twice, 1 at the end; the perturbed sample is left out.

    Heads 0.4 and 0.2: errors 0.21, 0.01 twice and -0.6, -0.8.
    """
    out = _loss(constant_actor(), constant_critic((0.4, 0.2))).critic_loss(batch)
    bellman = (2 * (0.21**2 + 0.01**2) + 0.6**2 + 0.8**2) / 2 / 3
    assert out["loss_qvalue"].item() == pytest.approx(bellman)
    assert out["loss_critic_aux"].item() == pytest.approx(0.04)
    mean = (0.21 + 0.21 + 0.8) / 3
    torch.testing.assert_close(batch["td_error"], torch.tensor([0.21, 0.21, 0.8, mean]))
    assert out["td_error"].item() == pytest.approx(mean)


@pytest.mark.parametrize(
    ("limits", "mean"), [(None, 0.3925), ((0.0, 0.1), 0.1), ([0.5, 2], 0.625), ((-1.0, 0.19), 0.19)]
)
def test_targets_are_clipped_to_possible_values(constant_actor, constant_critic, batch, limits, mean):
    """They are 0.19 three times, and 1 at the end."""
    loss = _loss(constant_actor(), constant_critic((0.4, 0.2)), value_limits=limits)
    assert loss.critic_loss(batch)["target_value"].item() == pytest.approx(mean)


@pytest.mark.parametrize("limits", [(1.0, 0.0), (1.0,), 3.0, ("low", "high"), (0.0, float("nan"))])
def test_impossible_limits_of_values_are_refused(constant_actor, constant_critic, limits):
    with pytest.raises(ConfigError, match="value_limits="):
        make_loss(constant_actor(), constant_critic(), value_limits=limits)


def test_where_no_error_counts_priorities_are_zero(constant_actor, constant_critic, batch):
    batch["perturbed"] = torch.ones(4, 1, dtype=torch.bool)
    _loss(constant_actor(), constant_critic((0.4, 0.2))).critic_loss(batch)
    assert not batch["td_error"].any()


def test_padding_has_the_mean_as_its_priority_too(constant_actor, constant_critic, batch):
    """Errors 0.21 and 0.21 count; the third sample, of no number, is padding, the fourth perturbed."""
    batch["collector", "mask"] = torch.tensor([[True], [True], [False], [True]])
    batch["next", "reward"][2] = torch.nan
    out = _loss(constant_actor(), constant_critic((0.4, 0.2))).critic_loss(batch)
    torch.testing.assert_close(batch["td_error"], torch.full((4,), 0.21))
    assert out["loss_qvalue"].isfinite()


def test_an_untrained_transition_does_not_crowd_out_the_others(constant_actor, constant_critic, batch):
    """However wrong the critic is of a perturbed transition, its priority is an ordinary one."""
    batch["next", "reward"][3] = 1000.0
    _loss(constant_actor(), constant_critic((0.4, 0.2))).critic_loss(batch)
    assert batch["td_error"].max().item() == pytest.approx(0.8)


def test_actor_terms_by_hand(constant_actor, constant_critic, batch):
    """λ = 0.2: 0.2 * 1.5 cm, 0.8 * (-0.4), and the goal term in full."""
    out = _loss(constant_actor(), constant_critic((0.4, 0.2))).actor_loss(batch)
    assert out["loss_actor_bc"].item() == pytest.approx(0.2 * 0.015)
    assert out["loss_actor_ddpg"].item() == pytest.approx(-0.8 * 0.4)
    assert out["loss_actor_aux"].item() == pytest.approx(0.04)


def test_hindsight_multiplies_both_goal_terms(constant_actor, constant_critic, batch):
    out = _loss(constant_actor(), constant_critic(), hindsight=True)(batch)
    assert out["loss_actor_aux"].item() == pytest.approx(0.01)
    assert out["loss_critic_aux"].item() == pytest.approx(0.01)


def test_two_targets_of_different_age(constant_actor, constant_critic, batch):
    """The first value comes from the first set (0.9), the second from the delayed set (0.5)."""
    loss = _loss(constant_actor(), constant_critic((0.0, 0.0)))
    first = loss.target_critic_network_params["module", "outputs", "0"]
    second = loss.target_delayed_critic_network_params["module", "outputs", "0"]
    first.copy_(torch.tensor([0.9, -7.0]))
    second.copy_(torch.tensor([-7.0, 0.5]))
    out = loss.critic_loss(batch)
    assert out["target_value"].item() == pytest.approx((3 * 0.95 * 0.5 + 1) / 4)


def test_a_checkpoint_leaves_the_configuration_alone(constant_actor, constant_critic, batch):
    """Saved with gamma 0.95 and limits of 1, loaded where gamma is 0.5 and the limits are 2."""
    saved = _loss(constant_actor(), constant_critic(), action_bound=[1.0] * 6)
    loss = _loss(constant_actor(), constant_critic((1.0, 1.0)), action_bound=[2.0] * 6)
    loss.make_value_estimator(gamma=0.5)
    loss.load_state_dict(saved.state_dict())
    assert loss.gamma == 0.5
    assert loss.smoothing.high.tolist() == [2.0] * 6
    loss.make_value_estimator(gamma=0.95)
    assert loss.to(torch.bfloat16).gamma == pytest.approx(0.95, rel=1e-6)
    assert loss.to(torch.float64).smoothing.low.dtype == torch.float64


def _encoder(channels):
    return PointNet(channels, 8, hidden=(8,))


def _grasp_networks():
    return GraspActor(_encoder, hidden=8), GraspCritic(_encoder, hidden=8)


@pytest.mark.parametrize("fusion", ["early", "late"])
@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_networks_of_any_precision_take_the_batch_as_it_is(batch, dtype, fusion):
    """Clouds, labels and rewards stay in float32; only the networks' own precision limits the terms."""
    torch.manual_seed(0)
    networks = GraspActor(_encoder, hidden=8), GraspCritic(_encoder, hidden=8, fusion=fusion)
    loss, batch = _loss(*networks, policy_noise=0.0), _grasp_batch(batch)
    expected = loss(batch.clone())
    found = loss.to(dtype)(batch)
    sum(value for key, value in found.items() if key.startswith("loss_")).backward()
    assert {p.grad.dtype for p in loss.parameters() if p.grad is not None} == {dtype}
    for key, value in found.items():
        torch.testing.assert_close(value, expected[key], rtol=0.05, atol=0.01, check_dtype=False)


def _grasp_batch(batch):
    points = torch.rand(2, 4, 12, 4, generator=torch.Generator().manual_seed(0))
    return batch.clone().set("points", points[0]).set(("next", "points"), points[1])


def test_gradients_stay_on_their_side(batch):
    torch.manual_seed(0)
    actor, critic = _grasp_networks()
    loss, batch = _loss(actor, critic), _grasp_batch(batch)
    for terms, own, other in ((loss.actor_loss, actor, critic), (loss.critic_loss, critic, actor)):
        out = terms(batch)
        sum(value for key, value in out.items() if key.startswith("loss_")).backward()
        assert all(p.grad is not None and p.grad.any() for p in own.module.encoder.parameters())
        assert all(p.grad is None for p in other.parameters())
        loss.zero_grad()


def test_the_critic_leads_the_actor(batch):
    """With the DDPG term alone, a step along its gradient raises Q1 at the actor's action."""
    torch.manual_seed(0)
    loss, batch = _loss(*_grasp_networks(), bc_weight=0.0, aux_weight=0.0), _grasp_batch(batch)
    before = loss.actor_loss(batch)["loss_actor_ddpg"]
    before.backward()
    with torch.no_grad():
        for parameter in loss.actor_network_params.parameters():
            if parameter.grad is not None:
                parameter -= 0.1 * parameter.grad
    assert loss.actor_loss(batch)["loss_actor_ddpg"] < before


def test_forward_is_both_sides(constant_actor, constant_critic, batch):
    loss = _loss(constant_actor(), constant_critic())
    out = loss(batch)
    assert set(out.keys()) == set(loss.out_keys)
    for key, value in {**loss.critic_loss(batch), **loss.actor_loss(batch)}.items():
        torch.testing.assert_close(out[key], value)


@pytest.mark.parametrize(
    ("options", "absent"),
    [
        ({"bc_weight": 0.0}, {"loss_actor_bc"}),
        ({"bc_weight": 1.0}, {"loss_actor_ddpg"}),
        ({"aux_weight": 0.0}, {"loss_actor_aux", "loss_critic_aux"}),
    ],
)
def test_terms_of_no_weight_are_absent(constant_actor, constant_critic, batch, options, absent):
    loss = _loss(constant_actor(), constant_critic(), **options)
    every = {"loss_qvalue", "loss_critic_aux", "loss_actor_bc", "loss_actor_ddpg", "loss_actor_aux"}
    found = {key for key in loss(batch).keys() if key.startswith("loss_")}  # noqa: SIM118
    assert found == every - absent
    assert set(loss.out_keys) >= found


def test_goal_terms_need_a_goal_prediction(constant_actor, constant_critic, batch):
    out = _loss(constant_actor(goal=None), constant_critic())(batch)
    assert "loss_actor_aux" not in out
    assert "loss_critic_aux" in out


@pytest.mark.parametrize(("reduction", "shape"), [("mean", ()), ("sum", ()), ("none", (4,))])
def test_reductions(constant_actor, constant_critic, batch, reduction, shape):
    loss = _loss(constant_actor(), constant_critic((0.4, 0.2)), reduction=reduction)
    out = loss(batch)
    assert all(value.shape == shape for key, value in out.items() if key.startswith("loss_"))
    if reduction == "none":
        assert out["loss_qvalue"][3] == 0.0


def test_time_dimensions(constant_actor, constant_critic, batch):
    loss = _loss(constant_actor(), constant_critic((0.4, 0.2)))
    flat = loss(batch.clone())
    for key, value in loss(torch.stack((batch, batch), dim=1)).items():
        torch.testing.assert_close(value, flat[key])


def test_dispatch(constant_actor, constant_critic, batch):
    loss = _loss(constant_actor(goal=None), constant_critic(goal=None), bc_weight=0.0)
    ends = batch["next"]
    named = {"time_left": batch["time_left"], "action": batch["action"], "next_time_left": ends["time_left"]}
    out = loss(**named, next_reward=ends["reward"], next_terminated=ends["terminated"])
    assert len(out) == len(loss.out_keys)


def test_every_key_can_be_set(constant_actor, constant_critic, batch):
    expected = _loss(constant_actor(), constant_critic((0.4, 0.2)))(batch.clone())
    actor = TensorDictModule(constant_actor().module, ["clock"], [("pi", "u"), "grasp"])
    critic = TensorDictModule(constant_critic((0.4, 0.2)).module, ["clock", ("pi", "u")], ["q", "grasp"])
    renamed = batch.clone()
    new = {
        "action": ("pi", "u"),
        "expert_action": ("label", "u"),
        "has_expert": ("label", "mask"),
        "goal": ("label", "grasp"),
        "has_goal": ("label", "grasp_mask"),
        "perturbed": "pushed",
        "episode_success": "won",
    }
    for old, key in new.items():
        renamed.rename_key_(old, key)
    for old, key in {"time_left": "clock", ("next", "time_left"): ("next", "clock")}.items():
        renamed.rename_key_(old, key)
    renamed.rename_key_(("next", "reward"), ("next", "r")).rename_key_(
        ("next", "terminated"), ("next", "end")
    )
    loss = _loss(actor, critic)
    ends = {"reward": "r", "terminated": "end", "priority": "urgency"}
    loss.set_keys(**new, **ends, state_action_value="q", goal_prediction="grasp")
    out = loss(renamed)
    for key, value in expected.items():
        torch.testing.assert_close(out[key], value)
    assert "urgency" in renamed


def _pendulum(num_critics):
    """TorchRL's own actor and critics on tensors of a pendulum's shapes."""
    spec = Bounded(-2.0, 2.0, (1,))
    actor = Actor(nn.Sequential(MLP(3, 1, num_cells=[16]), nn.Tanh()), in_keys=["observation"])
    critics = [
        ValueOperator(MLP(4, 1, num_cells=[16]), in_keys=["observation", "action"])
        for _ in range(num_critics)
    ]
    generator = torch.Generator().manual_seed(0)
    rows = {"observation": torch.randn(32, 3, generator=generator)}
    ends = {"reward": rows["observation"][:, :1], "terminated": torch.zeros(32, 1).bool()}
    ends["observation"] = torch.randn(32, 3, generator=generator)
    batch = TensorDict({**rows, "action": torch.zeros(32, 1), "next": ends}, [32])
    return actor, critics, spec, batch


@pytest.mark.parametrize("num_critics", [1, 2])
def test_foreign_networks_learn(num_critics):
    torch.manual_seed(0)
    actor, critics, spec, batch = _pendulum(num_critics)
    critic = critics[0] if num_critics == 1 else critics
    loss = GraspTD3BCLoss(actor, critic, bc_weight=0.0, action_spec=spec, policy_noise=0.0)
    loss.make_value_estimator(gamma=0.5)
    updater = StaggeredTargetUpdate(loss, tau=0.01, period=20)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-2)
    first = loss.critic_loss(batch)["loss_qvalue"].item()
    for _ in range(100):
        out = loss(batch)
        assert set(out.keys()) == set(loss.out_keys)
        optimizer.zero_grad()
        (out["loss_qvalue"] + out["loss_actor_ddpg"]).backward()
        optimizer.step()
        updater.step()
    assert loss.critic_loss(batch)["loss_qvalue"].item() < 0.3 * first


def test_a_list_of_critics_keeps_its_weights_and_trains_them():
    actor, critics, spec, batch = _pendulum(2)
    before = [[p.clone() for p in critic.parameters()] for critic in critics]
    loss = _loss(actor, critics, bc_weight=0.0, action_bound=None, action_spec=spec)
    for critic, weights in zip(critics, before, strict=True):
        for found, kept in zip(critic.parameters(), weights, strict=True):
            assert torch.equal(found, kept)
            assert any(found is p for p in loss.parameters())
    loss.critic_loss(batch)["loss_qvalue"].backward()
    assert all(p.grad is not None for critic in critics for p in critic.parameters())


def test_torchrls_updaters_serve_too(batch):
    loss = make_loss(*_grasp_networks())
    updater = SoftUpdate(loss, tau=0.5)
    name = ("module", "value_heads", "1", "0", "weight")
    start = loss.critic_network_params[name].data.clone()
    loss.critic_network_params[name].data += 1
    updater.step()
    for params in (loss.target_critic_network_params, loss.target_delayed_critic_network_params):
        torch.testing.assert_close(params[name], start + 0.5)
    assert loss(_grasp_batch(batch))["loss_qvalue"].isfinite()


def test_state_dict_carries_every_target(batch):
    first, second = _loss(*_grasp_networks()), _loss(*_grasp_networks())
    for parameter in first.target_delayed_critic_network_params.values(True, True):
        parameter.add_(0.1)
    second.load_state_dict(first.state_dict())
    batch, outs = _grasp_batch(batch), []
    for loss in (first, second):
        torch.manual_seed(0)
        outs.append(loss(batch))
    for key, value in outs[0].items():
        torch.testing.assert_close(value, outs[1][key])


def test_construction_and_use_warn_of_nothing(batch):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loss = make_loss(*_grasp_networks())
        StaggeredTargetUpdate(loss)
        loss(_grasp_batch(batch))


def test_wrong_use_says_what_to_do(constant_actor, constant_critic, batch):
    with pytest.raises(ConfigError, match=r"bc_weight=1\.2"):
        make_loss(constant_actor(), constant_critic(), bc_weight=1.2)
    with pytest.raises(ConfigError, match="hindsight=nan: give True or False"):
        make_loss(constant_actor(), constant_critic(), hindsight=float("nan"))
    with pytest.raises(ConfigError, match="same out_keys"):
        make_loss(constant_actor(), [constant_critic(), constant_critic(goal=None)])
    with pytest.raises(ConfigError, match="bc_weight=0"):
        _loss(constant_actor(), constant_critic()).actor_loss(batch.exclude("expert_action"))
    other = TensorDictModule(constant_actor(goal=None).module, ["time_left"], ["pi"])
    for side in ("actor_loss", "critic_loss"):
        with pytest.raises(ConfigError, match=r"'action', which its network .* set_keys\(action="):
            getattr(_loss(other, constant_critic()), side)(batch)


@pytest.mark.parametrize("num_q", [1, 2])
def test_networks_that_compute_what_is_asked_give_what_others_do(batch, num_q):
    """The same modules as a GraspCritic and as one that always computes everything."""
    batch, found = _grasp_batch(batch), []
    for foreign in (False, True):
        torch.manual_seed(0)
        networks = [GraspActor(_encoder, hidden=8), GraspCritic(_encoder, hidden=8, num_q=num_q)]
        if foreign:
            networks = [TensorDictModule(n.module, in_keys=n.in_keys, out_keys=n.out_keys) for n in networks]
        loss = _loss(*networks)
        loss.target_delayed_critic_network_params.data.mul_(1.1)
        torch.manual_seed(1)
        out = loss(batch.copy())
        sum(value for key, value in out.items() if key.startswith("loss_")).backward()
        found.append((out.detach(), [p.grad for p in loss.parameters() if p.grad is not None]))
    (ours, gradients), (theirs, expected) = found
    assert ours.keys() == theirs.keys() and all(
        torch.equal(value, theirs[key]) for key, value in ours.items()
    )
    for gradient, other in zip(gradients, expected, strict=True):
        assert torch.equal(gradient, other)
