"""Updates do the same compiled, as CUDA graphs and as they are; what no graph can hold is absent."""

import copy
from functools import partial

import pytest
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from tests.training.parts import make_actor_critic, make_batch, make_imitation_learner, weights
from torchgrasp import geometry
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GoalPredictor, GraspActor, GraspCritic, PointNet, PointNet2
from torchgrasp.objectives import GoalAuxLoss, GraspTD3BCLoss, PoseBCLoss, StaggeredTargetUpdate
from torchgrasp.runs.state_likeness import find_unlike
from torchgrasp.training import Acceleration
from torchgrasp.training.acceleration import get_optimizer_state, load_optimizer_state

# Operators that give a number, or a shape, to the host.
_READS = ("_local_scalar_dense", "nonzero", "masked_select", "unique", "is_nonzero", "equal")


class _Watch(TorchDispatchMode):
    """Notes operators that wait for a device."""

    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.name().split("::")[-1].split(".")[0]
        masks = [each for each in args[1] if each is not None] if name in ("index", "index_put_") else []
        if name in _READS or any(mask.dtype == torch.bool for mask in masks):
            self.found.add(name)
        return func(*args, **(kwargs or {}))


class _WatchCopies(TorchFunctionMode):
    """Notes tensors that are made of Python's numbers, which are copied to the device."""

    def __init__(self) -> None:
        super().__init__()
        self.made: list[tuple] = []

    def __torch_function__(self, func, types, args=(), kwargs=None):
        if getattr(func, "__name__", "") in ("tensor", "as_tensor", "new_tensor", "from_numpy"):
            self.made.append(args)
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize("encoder", [PointNet, PointNet2])
def test_losses_and_soft_targets_read_nothing_on_the_host(encoder):
    """So a CUDA graph can hold them; Adam's own steps are torch's."""
    encoder = partial(encoder, width=0.25, norm="batch")  # every row passes, as on a CUDA device
    reads = {"goal_input": True, "table_input": True}
    actor, critic = GraspActor(encoder, **reads), GraspCritic(encoder, **reads)
    predictor = GoalPredictor(encoder, table_input=True)
    loss = GraspTD3BCLoss(actor, critic, action_bound=ACTION_BOUND)
    targets, imitation, aux = (
        StaggeredTargetUpdate(loss),
        PoseBCLoss(actor, aux_weight=1.0),
        GoalAuxLoss(predictor),
    )
    aux.set_keys(goal_prediction="goal")
    batch = make_batch()
    for state in (batch, batch["next"]):
        state["table_plane"] = torch.rand(len(batch), 4)
    with _Watch() as watch, _WatchCopies() as copies:
        for compute in (imitation, loss.critic_loss, loss.actor_loss, aux):
            terms = compute(batch.copy())
            torch.stack([value for key, value in terms.items() if key.startswith("loss_")]).sum().backward()
        targets.follow()
    assert not watch.found and copies.made == [(geometry._CONTROL_POINTS,)] * len(copies.made)
    with _Watch() as watch:
        torch.rand(3)[torch.rand(3) > 0.5].sum().item()
    assert watch.found == {"index", "_local_scalar_dense"}


def learn(learner, number: int = 3) -> None:
    for seed in range(number):
        batch = make_batch(seed=seed).to(learner.acceleration.device)
        learner.set_rate(1e-3 / (1 + seed))
        learner.imitate(batch)
        learner.update_critic(batch)
        learner.update_actor(batch)


def assert_alike(learner, other) -> None:
    assert learner.fetch_terms() == pytest.approx(other.fetch_terms(), rel=1e-4, abs=1e-6)
    torch.testing.assert_close(weights(learner.loss), weights(other.loss), rtol=1e-4, atol=1e-5)


def test_a_compiled_update_does_the_same_and_its_losses_are_one_graph():
    plain, compiled = make_imitation_learner(), make_imitation_learner()
    adam = Acceleration(compile="default").make_adam(compiled.actor.parameters())
    compiled.optimizers["actor"] = adam  # its rate is a tensor: a number would be compiled in
    torch._dynamo.utils.counters.clear()
    # Without the code that torch's compiler would generate, which takes long.
    compiled._imitation_update = torch.compile(compiled._imitation_update, backend="eager")
    for learner in (plain, compiled):
        for seed in range(3):
            learner.set_rate(1e-3 / (1 + seed))
            learner.imitate(make_batch(seed=seed))
    assert compiled.fetch_terms() == pytest.approx(plain.fetch_terms())
    torch.testing.assert_close(weights(compiled.actor), weights(plain.actor))
    # The optimizer's own, and that of backward.
    known = ("Tensor.backward()", "`Optimizer.zero_grad`", "torch._dynamo.graph_break()")
    breaks = torch._dynamo.utils.counters["graph_break"]
    assert breaks and all(any(name in reason for name in known) for reason in breaks)


def test_a_checkpoint_does_not_tell_how_updates_were_run():
    network = torch.nn.Linear(2, 2)
    plain, fast = (Acceleration(compile=mode).make_adam(network.parameters()) for mode in (None, "default"))
    fast.param_groups[0]["lr"].fill_(0.5)
    network(torch.ones(2)).sum().backward()
    fast.step()
    state = get_optimizer_state(fast)
    assert find_unlike(get_optimizer_state(plain), {**state, "state": {}}) is None
    assert state["param_groups"][0]["lr"] == 0.5 and type(state["param_groups"][0]["lr"]) is float
    load_optimizer_state(plain, copy.deepcopy(state))
    assert plain.param_groups[0]["lr"] == 0.5 and plain.state_dict()["state"][0]["step"] == 1.0
    rate = fast.param_groups[0]["lr"]
    load_optimizer_state(fast, {**state, "param_groups": [{**state["param_groups"][0], "lr": 0.25}]})
    assert fast.param_groups[0]["lr"] is rate and rate == 0.25


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"compile": "max"}, "compile='max' is unknown"),
        ({"compile": "reduce-overhead", "cudagraphs": True, "device": "cuda"}, "give compile='default'"),
        ({"cudagraphs": True}, "cudagraphs=True with device=cpu"),
    ],
)
def test_what_does_not_go_together_is_refused(options, told):
    with pytest.raises(ConfigError, match=told):
        Acceleration(**options)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_recorded_updates_do_the_same_on_a_gpu():
    plain, recorded = (
        make_actor_critic(acceleration=Acceleration(cudagraphs=graphs, device="cuda"))
        for graphs in (False, True)
    )
    for learner in (plain, recorded):
        torch.manual_seed(0)
        learn(learner, 8)
    assert_alike(recorded, plain)
