"""A policy that acts by the mean over the hand's reflections: equivariant, refused for what it cannot see."""

import pytest
import torch
from tensordict import TensorDict

import torchgrasp
from torchgrasp import keys
from torchgrasp.config.learners import make_actor_critic
from torchgrasp.errors import ConfigError
from torchgrasp.modules import GraspActor, MirroredPolicy, PointNet, ResidualPolicy
from torchgrasp.modules.policy import join_policy
from torchgrasp.runs.weights import PRETRAINED, load_weights, save_weights
from torchgrasp.transforms import RandomMirror

MIRROR = RandomMirror()
SIGNS = [(-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]


def make_states(*shape: int) -> TensorDict:
    torch.manual_seed(0)
    points = torch.cat((torch.rand(*shape, 40, 3) - 0.5, torch.zeros(*shape, 40, 1)), dim=-1)
    return TensorDict({"points": points, "time_left": torch.rand(*shape, 1)}, list(shape))


@pytest.fixture
def actor():
    torch.manual_seed(1)
    actor = GraspActor(PointNet).eval().requires_grad_(False)
    for layer in actor.modules():  # heads begin near zero, where everything is its own mirror image
        if isinstance(layer, torch.nn.Linear):
            torch.nn.init.normal_(layer.weight, std=0.3)
    return actor


@pytest.mark.parametrize("signs", SIGNS)
def test_the_reflected_state_gets_the_reflected_action(actor, signs):
    states = make_states(5)
    policy, turned = MirroredPolicy(actor, MIRROR), torch.tensor(signs).expand(5, 2)
    says = policy(states.clone())["action"]
    again = policy(MIRROR.reflect(states.clone(), turned))["action"]
    expected = MIRROR.reflect(TensorDict({"action": says}, [5]), turned)["action"]
    assert torch.allclose(again, expected, atol=1e-6)
    itself = actor(states.clone())["action"]
    assert not torch.allclose(itself, says, atol=1e-3)  # the network alone is not


def test_the_action_is_the_mean_of_what_the_policy_does_in_each_mirror(actor):
    states, total = make_states(3), torch.zeros(3, 6)
    for signs in [(1.0, 1.0), *SIGNS]:
        seen = actor(MIRROR.reflect(states.clone(), torch.tensor(signs).expand(3, 2)))
        total += MIRROR.reflect(seen, torch.tensor(signs).expand(3, 2))["action"]
    assert torch.allclose(MirroredPolicy(actor, MIRROR)(states.clone())["action"], total / 4, atol=1e-6)


def test_any_batch_shape_and_what_was_there_stays(actor):
    policy, states = MirroredPolicy(actor, MIRROR), make_states(2, 3)
    out = policy(states.clone())
    assert out["action"].shape == (2, 3, 6) and torch.equal(out["points"], states["points"])
    flat = policy(states.reshape(6))
    assert torch.allclose(flat["action"].reshape(2, 3, 6), out["action"], atol=1e-6)
    one = policy(states[0, 0].clone())
    assert torch.allclose(one["action"], out["action"][0, 0], atol=1e-6)


def test_what_else_a_policy_writes_is_that_of_the_state_as_it_is(actor):
    residual = ResidualPolicy(actor).eval().requires_grad_(False)
    out = join_policy({"actor": residual}, MIRROR)(make_states(4))
    itself = residual(make_states(4))
    for key in (keys.BASE_ACTION, keys.GOAL_PREDICTION):
        assert torch.allclose(out[key], itself[key], atol=1e-6)
    assert not torch.allclose(out["action"], itself["action"], atol=1e-3)


def test_batches_that_the_tensordict_does_not_tell(actor):
    states = make_states(4)
    untold = TensorDict(dict(states.items()), [])
    policy = MirroredPolicy(actor, MIRROR)
    assert torch.allclose(policy(untold)["action"], policy(states)["action"], atol=1e-6)


def test_what_cannot_be_reflected_is_refused(actor):
    joints = GraspActor(PointNet, state_inputs={"joints": 9})
    with pytest.raises(ConfigError, match=r"reads 'joints', whose reflection is not known.* act as it is"):
        MirroredPolicy(joints, MIRROR)
    with pytest.raises(ConfigError, match="policy writes no 'act': name the action by action_key"):
        MirroredPolicy(actor, MIRROR, action_key="act")
    with pytest.raises(ConfigError, match="mirror knows no 'action'"):
        MirroredPolicy(actor, RandomMirror(action_keys=["act"]))


def test_a_learner_s_policy_is_mirrored_where_the_model_says_so(composed):
    learner = make_actor_critic(composed("experiment=smoke", "model.mirrored=true"))
    assert isinstance(learner.policy, MirroredPolicy) and learner.policy.policy is learner.actor
    assert not isinstance(make_actor_critic(composed("experiment=smoke")).policy, MirroredPolicy)
    with pytest.raises(ConfigError, match="reads 'image', whose reflection"):
        make_actor_critic(
            composed("experiment=smoke", "transforms=rgbd", "model=resnet18", "model.mirrored=true")
        )


def test_a_weights_file_says_that_its_policy_is_mirrored(tmp_path):
    states, config = load_weights(PRETRAINED)
    for mirrored in (True, False):
        config["model"]["mirrored"] = mirrored
        save_weights(tmp_path / "policy.safetensors", states, config)
        policy = torchgrasp.load_policy(str(tmp_path / "policy.safetensors"))
        assert any(isinstance(each, MirroredPolicy) for each in policy.modules()) is mirrored
