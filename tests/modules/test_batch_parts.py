"""A batch in parts gives what it gives in one piece, and the same gradients."""

import os
from functools import partial

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import GraspActor, GraspCritic, PointNet, PointNet2
from torchgrasp.modules import batch_parts as module
from torchgrasp.modules.batch_parts import batches_in_parts, encode_in_parts
from torchgrasp.objectives import GraspTD3BCLoss
from torchgrasp.training.cores import updates_on_cores

CLOUD = partial(PointNet, out_features=16, hidden=(8, 16))
ROWS = 40


@pytest.fixture
def seen(monkeypatch):
    """Sizes of the batches that PointNets are given."""
    sizes, forward = [], PointNet.forward

    def note(self, points, mask=None):
        sizes.append(len(points))
        return forward(self, points, mask)

    monkeypatch.setattr(PointNet, "forward", note)
    return sizes


def make_batch(rows=ROWS):
    torch.manual_seed(0)
    state = {"points": 0.1 * torch.rand(rows, 12, 4), "time_left": torch.rand(rows, 1)}
    ends = {"reward": torch.rand(rows, 1), "terminated": torch.rand(rows, 1) < 0.2}
    labels = {
        "action": torch.rand(rows, 6),
        "expert_action": torch.rand(rows, 6),
        "goal": torch.rand(rows, 7),
    }
    return TensorDict({**state, **labels, "next": {**state, **ends}}, [rows])


def compute(number, fusion):
    """Terms of Eq. (3) and (4), and the gradients of all weights."""
    torch.manual_seed(0)
    networks = GraspActor(CLOUD), GraspCritic(CLOUD, fusion=fusion)
    loss = GraspTD3BCLoss(*networks, action_bound=ACTION_BOUND, policy_noise=0.0)
    with batches_in_parts(number):
        terms = loss(make_batch())
        sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
    gradients = {name: each.grad for net in networks for name, each in net.named_parameters()}
    return dict(terms.detach().items()), gradients


@pytest.mark.parametrize("fusion", ["early", "late"])
def test_losses_and_gradients_are_those_of_one_piece(fusion, seen):
    whole = compute(1, fusion)
    assert set(seen) == {ROWS}
    seen.clear()
    parted, again = compute(2, fusion), compute(2, fusion)
    assert set(seen) == {ROWS // 2}
    for one, two, three in zip(whole, parted, again, strict=True):
        for key, value in one.items():
            torch.testing.assert_close(two[key], value, rtol=1e-4, atol=1e-6)
            assert torch.equal(two[key], three[key])  # whichever thread was first


def test_a_gradient_passes_through_to_the_input():
    torch.manual_seed(0)
    encoder = PointNet(4, out_features=8).requires_grad_(False)
    clouds = [
        torch.rand(ROWS, 9, 4, generator=torch.Generator().manual_seed(1)).requires_grad_() for _ in "ab"
    ]
    encoder(clouds[0]).sum().backward()
    with batches_in_parts(2):
        encode_in_parts(encoder, clouds[1]).sum().backward()
    torch.testing.assert_close(clouds[1].grad, clouds[0].grad)


@pytest.mark.parametrize("rows", [4, 31])
def test_small_batches_stay_whole(rows, seen):
    with batches_in_parts(2):
        encode_in_parts(PointNet(4), torch.rand(rows, 9, 4))
    assert seen == [rows]


@pytest.mark.parametrize("encoder", [PointNet(4, norm="batch"), PointNet2(4, width=0.1, start="random")])
def test_encoders_whose_rows_belong_together_get_them_together(encoder):
    with batches_in_parts(2):
        assert not module._can_be_parted(encoder, torch.rand(64, 9, 4))
        assert module._can_be_parted(PointNet(4), torch.rand(64, 9, 4))


def test_cores_are_given_back_and_one_is_said_to_be_one(monkeypatch):
    monkeypatch.setattr("torchgrasp.training.cores.count_cores", lambda: 2)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with updates_on_cores([PointNet(4)]) as told:
            assert "2 cores, a batch in 4 parts" in told and torch.get_num_threads() == 1
            assert module._threads.number == 4
        assert torch.get_num_threads() == 2 and module._threads.number == 1
        with updates_on_cores([PointNet(4, norm="batch")]) as told:
            assert told == "Updates use 2 cores" and torch.get_num_threads() == 2
        with updates_on_cores([PointNet(4)], "cuda") as told:
            assert told == "Updates run on cuda" and module._threads.number == 1
    finally:
        torch.set_num_threads(before)


def test_a_process_that_is_forked_has_no_parts():
    with batches_in_parts(2):
        child = os.fork()
        if child == 0:
            os._exit(module._threads.number)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
