"""ResidualActor: a frozen base policy, and a bounded correction that starts at zero."""

from __future__ import annotations

import pickle
from copy import deepcopy

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Bounded, LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import PendulumEnv
from torchrl.envs.utils import step_mdp
from torchrl.modules import MLP

from torchgrasp.errors import ConfigError
from torchgrasp.modules import (
    ACTOR_FEATURE,
    GivenFeature,
    GoalPredictor,
    GraspActor,
    GraspCritic,
    PointNet,
    ResidualActor,
    ResidualPolicy,
    split_network,
)
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate

STATE = ("angle", "rate")
BOUND = [2.0]


def make_base() -> TensorDictModule:
    return TensorDictModule(nn.Linear(1, 1), ["angle"], ["action"])


def make_actor(base: TensorDictModule | None = None, **options) -> ResidualActor:
    options = {"in_keys": STATE, "action_bound": BOUND, **options}
    return ResidualActor(base or make_base(), MLP(3, 1, num_cells=[16]), **options)


def make_state(count: int = 8, size: float = 1.0) -> TensorDict:
    return TensorDict({key: size * torch.randn(count, 1) for key in STATE}, [count])


def push(actor: ResidualActor, by: float) -> None:
    """Have the correction ask for `by` everywhere."""
    last = [each for each in actor.correction.modules() if isinstance(each, nn.Linear)][-1]
    nn.init.constant_(last.bias, by)


def test_it_begins_as_the_base_policy() -> None:
    base, state = make_base(), make_state()
    written = make_actor(base)(state.copy())
    assert torch.equal(written["action"], base(state.copy())["action"].clamp(-2, 2))
    assert torch.equal(written["base_action"], base(state.copy())["action"])


@pytest.mark.parametrize("scale", [0.0, 0.1, 1.0])
def test_the_correction_is_bounded(scale: float) -> None:
    actor, state = make_actor(scale=scale), make_state(64)
    push(actor, 50.0)
    written = actor(state)
    expected = (written["base_action"] + 2.0 * scale).clamp(max=2.0)
    assert torch.allclose(written["action"], expected)


def test_limits_of_a_spec_need_not_be_symmetric() -> None:
    spec = Bounded(torch.tensor([0.0]), torch.tensor([4.0]), [1])
    base = TensorDictModule(lambda angle: 0 * angle + 3.9, ["angle"], ["action"])
    actor = make_actor(base, action_bound=None, action_spec=spec, scale=0.5)
    push(actor, 50.0)
    assert torch.equal(actor(make_state(2))["action"], torch.full((2, 1), 4.0))
    push(actor, -50.0)
    assert torch.allclose(actor(make_state(2))["action"], torch.full((2, 1), 2.9))


def test_a_component_that_cannot_move_stays() -> None:
    spec = Bounded(torch.tensor([0.5]), torch.tensor([0.5]), [1])
    actor = make_actor(action_bound=None, action_spec=spec)
    push(actor, 50.0)
    assert torch.equal(actor(make_state(3))["action"], torch.full((3, 1), 0.5))


def test_gradients_reach_the_correction_alone() -> None:
    actor = make_actor()
    actor(make_state())["action"].sum().backward()
    assert all(each.grad is None and not each.requires_grad for each in actor.base.parameters())
    assert any(each.grad is not None and bool(each.grad.any()) for each in actor.correction.parameters())


def test_the_given_base_policy_goes_on_learning() -> None:
    base = make_base()
    actor = make_actor(base)
    assert all(each.requires_grad for each in base.parameters())
    own = make_actor(base, copy_base=False)
    assert own.base is base and not any(each.requires_grad for each in base.parameters())
    assert actor.base is not base


def test_the_base_policy_stays_in_evaluation_mode() -> None:
    network = nn.Sequential(nn.Dropout(0.9), nn.Linear(1, 1))
    actor = make_actor(TensorDictModule(network, ["angle"], ["action"])).train()
    state = make_state()
    assert actor.correction.training and not actor.base.training
    assert torch.equal(actor(state.copy())["base_action"], actor(state.copy())["base_action"])


def test_weights_travel_with_both_parts() -> None:
    first, second, state = make_actor(), make_actor(), make_state()
    push(first, 0.3)
    second.load_state_dict(first.state_dict())
    assert torch.equal(first(state.copy())["action"], second(state.copy())["action"])


def test_what_else_the_base_policy_writes_is_passed_on() -> None:
    base = GraspActor(PointNet)
    correction = MLP(1 + 6, 6, num_cells=[16])
    actor = ResidualActor(base, correction, in_keys=["time_left"], action_bound=[0.06] * 3 + [0.3] * 3)
    assert actor.in_keys == ["points", "time_left"]
    assert actor.out_keys == ["action", "goal_prediction", "base_action"]
    state = TensorDict({"points": torch.rand(2, 64, 4), "time_left": torch.ones(2, 1)}, [2])
    assert torch.equal(actor(state.copy())["goal_prediction"], base.eval()(state.copy())["goal_prediction"])


def test_the_correction_may_read_what_the_base_policy_writes() -> None:
    """One pass of the encoder serves both."""
    encoder, rest = split_network(GraspActor(PointNet, freeze_encoder=True), "feature")
    base: list = [encoder, rest]
    size = encoder.module.encoder.out_features
    actor = ResidualActor(
        TensorDictSequential(*base),
        MLP(size + 6, 6),
        in_keys=["feature"],
        action_bound=[0.06] * 3 + [0.3] * 3,
    )
    assert actor.in_keys == ["points", "time_left"]
    state = TensorDict({"points": torch.rand(2, 64, 4), "time_left": torch.ones(2, 1)}, [2])
    push(actor, 50.0)
    written = actor(state)
    assert written["feature"].shape == (2, size)
    moved = written["action"] - written["base_action"]
    assert torch.allclose(moved, torch.tensor([0.006] * 3 + [0.03] * 3).expand(2, 6), atol=1e-6)


def test_any_batch_will_do() -> None:
    actor, state = make_actor(), make_state(12)
    expected = actor(state.copy())["action"]
    assert torch.equal(actor(state.reshape(3, 4))["action"].reshape(-1, 1), expected)
    assert torch.equal(actor(angle=state["angle"], rate=state["rate"])[0], expected)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"scale": 1.5}, "scale=1.5"),
        ({"action_bound": None}, "action_bound and action_spec are missing"),
        ({"action_key": "torque"}, r"base writes \['action'\] and no 'torque'"),
        ({"base_action_key": "action"}, "base_action_key='action' is written by the base policy"),
        ({"in_keys": "angle"}, "in_keys='angle': give a list"),
    ],
)
def test_wrong_arguments_are_refused(options: dict, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        make_actor(**options)


@pytest.mark.parametrize(
    ("options", "outputs", "told"),
    [
        ({"action_bound": [2.0, 2.0]}, 1, "the limits have 2 components and the action 1"),
        ({}, 6, "correction gives"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(options: dict, outputs: int, told: str) -> None:
    options = {"in_keys": STATE, "action_bound": BOUND, **options}
    actor = ResidualActor(make_base(), MLP(3, outputs, num_cells=[16]), **options)
    with pytest.raises(ConfigError, match=told):
        actor(make_state())


def test_copies_for_other_processes_do_the_same() -> None:
    actor, state = make_actor(), make_state()
    push(actor, 0.4)
    for copied in (deepcopy(actor), pickle.loads(pickle.dumps(actor))):
        assert torch.equal(copied(state.copy())["action"], actor(state.copy())["action"])


@pytest.mark.parametrize(
    "correction", [nn.Tanh(), nn.Sequential(nn.Linear(3, 1), nn.LayerNorm(1)), MLP(out_features=1, depth=0)]
)
def test_a_correction_that_cannot_start_at_zero_is_refused(correction: nn.Module) -> None:
    with pytest.raises(ConfigError, match=r"correction (ends with|has a lazy layer)"):
        ResidualActor(make_base(), correction, in_keys=STATE, action_bound=BOUND)


# A pendulum of TorchRL that starts upright and is to stay there, for so many steps.
_HORIZON, _WORLDS, _ROUNDS, _UPDATES = 40, 16, 4, 60


class Weak(nn.Module):
    """A controller whose motor is off by a constant: it hangs beside the upright pose."""

    def forward(self, angle: Tensor, rate: Tensor) -> Tensor:
        return (-8.0 * angle - 2.0 * rate + 1.5).clamp(-2, 2).unsqueeze(-1)


class Tell(nn.Module):
    """A network of the pendulum's state, whose entries are (*), and vectors (*, D)."""

    def __init__(self, num_inputs: int) -> None:
        super().__init__()
        self.layers = MLP(num_inputs, 1, num_cells=[64, 64], activation_class=nn.ReLU)

    def forward(self, angle: Tensor, rate: Tensor, *vectors: Tensor) -> Tensor:
        return self.layers(torch.stack((4 * angle, rate), dim=-1), *vectors)


def run_episodes(env: PendulumEnv, policy: TensorDictModule | ResidualActor, noise: float) -> TensorDictBase:
    now = env.reset(env.gen_params(batch_size=[_WORLDS]), set_state=False)
    for key in ("th", "thdot"):
        now[key] = 0.2 * torch.rand(_WORLDS) - 0.1
    steps = []
    for _ in range(_HORIZON):
        with torch.no_grad():
            acted = policy(now)
        acted["action"] = (acted["action"] + noise * torch.randn(_WORLDS, 1)).clamp(-2, 2)
        steps.append(env.step(acted))
        now = step_mdp(steps[-1])
    return torch.cat([step.unsqueeze(-1) for step in steps], dim=-1)


def descend(adam: torch.optim.Optimizer, terms: TensorDictBase) -> None:
    adam.zero_grad()
    sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
    adam.step()


def test_a_residual_improves_a_mediocre_controller_of_a_torchrl_environment() -> None:
    torch.manual_seed(0)
    env, keys = PendulumEnv(seed=0), ["th", "thdot"]
    base = TensorDictModule(Weak(), keys, ["action"])
    actor = ResidualActor(base, Tell(3), in_keys=keys, action_spec=env.action_spec, scale=0.3)
    critics = [TensorDictModule(Tell(3), [*keys, "action"], ["state_action_value"]) for _ in range(2)]
    loss = GraspTD3BCLoss(actor, critics, bc_weight=0.0, action_bound=BOUND)
    loss.make_value_estimator(gamma=0.9)
    targets = StaggeredTargetUpdate(loss, tau=0.02, period=50)
    learning = (loss.critic_network_params, actor.correction)
    adam_critic, adam_actor = (torch.optim.Adam(each.parameters(), lr=3e-3) for each in learning)
    size = _HORIZON * _WORLDS * _ROUNDS
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(size), batch_size=128)
    before = run_episodes(env, base, noise=0.0)["next", "reward"].sum((-1, -2)).mean()
    for _ in range(_ROUNDS):
        steps = run_episodes(env, actor, noise=0.2).reshape(-1)
        following = [("next", key) for key in (*keys, "reward", "terminated")]
        buffer.extend(steps.select(*keys, "action", *following))
        for number in range(_UPDATES):
            batch = buffer.sample()
            descend(adam_critic, loss.critic_loss(batch))
            targets.step()
            if number % 2:
                descend(adam_actor, loss.actor_loss(batch))
    after = run_episodes(env, actor, noise=0.0)["next", "reward"].sum((-1, -2)).mean()
    assert after > 0.5 * before, (before, after)


def see(count: int = 8) -> TensorDict:
    state = {"points": torch.rand(count, 32, 4), "time_left": torch.rand(count, 1)}
    return TensorDict({**state, "table_plane": torch.rand(count, 4)}, [count])


def test_a_residual_policy_begins_as_the_actor_and_looks_once() -> None:
    actor, state = GraspActor(PointNet, table_input=True), see()
    before = actor(state.copy())
    policy = ResidualPolicy(actor, scale=0.1)
    written = policy(state.copy())
    for key in ("action", "goal_prediction"):
        assert torch.equal(written[key], before[key])
    assert written[ACTOR_FEATURE].shape == (8, policy.feature_size)
    assert torch.equal(policy.residual(policy.encoder(state.copy()))["action"], written["action"])


def test_of_a_residual_policy_the_correction_alone_learns() -> None:
    policy = ResidualPolicy(GraspActor(PointNet)).train()
    learning = [name for name, each in policy.named_parameters() if each.requires_grad]
    assert learning and all("correction" in name for name in learning)
    encoder: nn.Module = policy.encoder.module
    assert not encoder.encoder.training


def test_a_critic_learns_on_the_feature_of_the_residual_policy() -> None:
    policy = ResidualPolicy(GraspActor(PointNet))
    in_keys = [list(ACTOR_FEATURE), "time_left", "action"]  # as YAML has them
    critic = GraspCritic(GivenFeature(policy.feature_size), fusion="late", in_keys=in_keys)
    assert critic(policy(see()))["state_action_value"].shape == (8, 2)


def test_what_is_no_actor_on_an_encoder_is_no_base_of_a_residual_policy() -> None:
    with pytest.raises(ConfigError, match="has no encoder"):
        ResidualPolicy(make_base())
    with pytest.raises(ConfigError, match="no action: give a GraspActor"):
        ResidualPolicy(GoalPredictor(PointNet))
    with pytest.raises(ConfigError, match="hidden=0"):
        ResidualPolicy(GraspActor(PointNet), hidden=0)
    with pytest.raises(ConfigError, match="last_steps=1 without horizon"):
        ResidualPolicy(GraspActor(PointNet), last_steps=1)


def test_a_part_of_a_residual_policy_is_a_sequence() -> None:
    part = ResidualPolicy(GraspActor(PointNet)).select_subsequence(out_keys=[ACTOR_FEATURE])
    assert part.out_keys == [ACTOR_FEATURE]


@pytest.mark.parametrize("last_steps", [1, 3])
def test_the_last_steps_alone_are_corrected_on_demand(last_steps: int) -> None:
    policy = ResidualPolicy(GraspActor(PointNet), last_steps=last_steps, horizon=10)
    push(policy.residual, 50.0)
    state = see(10).set("time_left", torch.arange(1, 11)[:, None] / 10)
    written = policy(state)
    changed = (written["action"] != written["base_action"]).any(-1)
    assert changed.tolist() == [left < last_steps for left in range(10)]
    with pytest.raises(ConfigError, match="last_steps=11"):
        ResidualPolicy(GraspActor(PointNet), last_steps=11, horizon=10)
