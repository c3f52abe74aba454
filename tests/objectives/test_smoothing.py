"""Target smoothing: noise within limits, and where the limits come from."""

import pytest
import torch
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import ParallelEnv, PendulumEnv, SerialEnv
from torchrl.modules import MLP, Actor

from torchgrasp.errors import ConfigError
from torchgrasp.objectives import GraspTD3BCLoss
from torchgrasp.objectives.smoothing import TargetSmoothing

LOW, HIGH = torch.tensor([-1.0, 0.0]), torch.tensor([1.0, 3.0])
SPEC = Bounded(LOW, HIGH, (2,))
BATCH = Bounded(LOW.expand(3, 2), HIGH.expand(3, 2), (3, 2))


def make(**options):
    return TargetSmoothing(**{"policy_noise": 0.0, "noise_clip": 0.5, **options})


def test_noise_is_clipped_bounded_and_reproducible():
    """Half ranges of 0.06: noise of at most a quarter of that, on top of 0.05."""
    found = []
    for _ in range(2):
        generator = torch.Generator().manual_seed(1)
        smoothing = make(policy_noise=5.0, noise_clip=0.25, action_bound=[0.06] * 3, generator=generator)
        found.append(smoothing(torch.full((50, 3), 0.05)))
    assert torch.equal(*found)
    assert (found[0] <= 0.06).all()
    assert (found[0] >= 0.05 - 0.25 * 0.06 - 1e-6).all()
    assert found[0].unique().numel() > 2


@pytest.mark.parametrize(
    "spec",
    [
        SPEC,
        BATCH,
        Composite(action=SPEC),
        Composite(action=BATCH, shape=(3,)),
        Composite(action=SPEC, goal_prediction=Unbounded(7), param=None),
        Composite(agent=Composite(torque=SPEC)),
        Actor(MLP(3, 2), spec=SPEC).spec,
    ],
)
def test_limits_of_any_spec_that_holds_them(spec):
    smoothing = make(action_spec=spec)
    assert torch.equal(smoothing.low, LOW) and torch.equal(smoothing.high, HIGH)


def test_a_key_chooses_among_several_actions():
    spec = Composite(arm=Composite(action=SPEC), hand=Bounded(-5.0, 5.0, (1,)))
    assert torch.equal(make(action_spec=spec, action_key=("arm", "action")).high, HIGH)
    assert make(action_spec=spec, action_key="hand").high.tolist() == [5.0]
    with pytest.raises(ConfigError, match=r"\('arm', 'action'\), 'hand'\] has no 'action'"):
        make(action_spec=spec)


@pytest.mark.parametrize("batched", [None, SerialEnv, ParallelEnv])
def test_the_specs_of_an_environment(batched):
    env = PendulumEnv() if batched is None else batched(2, PendulumEnv)
    try:
        for spec in (env.action_spec, env.full_action_spec, env.input_spec["full_action_spec"]):
            assert make(action_spec=spec).high.tolist() == [2.0]
    finally:
        if not env.is_closed:
            env.close()


@pytest.mark.parametrize("given", [{}, {"action_bound": [1.0, 1.0], "action_spec": SPEC}])
def test_one_of_bound_and_spec_is_to_be_given(given, constant_actor, constant_critic):
    """A limit that nobody asked for would clip target actions in silence."""
    for build in (make, lambda **options: GraspTD3BCLoss(constant_actor(), constant_critic(), **options)):
        with pytest.raises(ConfigError, match="but not both") as caught:
            build(**given)
        assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("wrong", [2.0, [0.1, float("inf")], [], [-1.0]])
def test_a_bound_is_positive_and_finite(wrong):
    with pytest.raises(ConfigError, match=r"action_bound=.* such as \[2\.0\]"):
        make(action_bound=wrong)


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        (object(), "action_spec=object"),
        (Unbounded(2), "action_spec=Unbounded.* has no limits"),
        (Composite(action=Unbounded(2)), "action_spec=Unbounded.* has no limits"),
        (Composite(), "has no 'action'"),
        (Bounded(torch.tensor([-1.0, -torch.inf]), torch.ones(2), (2,)), "finite"),
        (Bounded(-torch.ones(2, 1), torch.tensor([[1.0], [2.0]]), (2, 1)), "other limits"),
    ],
)
def test_a_spec_without_such_limits_is_refused(spec, told):
    with pytest.raises(ConfigError, match=told) as caught:
        make(action_spec=spec)
    assert len(str(caught.value).splitlines()) == 1


def test_limits_of_another_size_are_refused():
    with pytest.raises(ConfigError, match="3 components and the action 6"):
        make(action_bound=[1.0] * 3)(torch.zeros(4, 6))
