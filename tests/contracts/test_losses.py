"""What every loss of the library keeps to, whatever it computes."""

from __future__ import annotations

import pickle
import warnings
from copy import deepcopy
from dataclasses import fields

import pytest
import torch
from tensordict import TensorDict, lazy_stack, unravel_key
from torch import Tensor, nn
from torchrl.objectives import LossModule

import torchgrasp.objectives as library
from tests.contracts.loss_cases import CASES, Case, Names, assert_same, gradients, losses, make_batch, total
from torchgrasp.errors import ConfigError
from torchgrasp.objectives import GoalAuxLoss, PoseBCLoss

MASKS = ("has_expert", "has_goal", "episode_success", "perturbed", ("next", "terminated"))
# TD(0) does not read it; tests/objectives/test_bootstrapped_loss.py has the estimators that do.
UNREAD = ("next", "done")


@pytest.fixture(params=CASES, ids=lambda case: case.kind.__name__)
def case(request) -> Case:
    return request.param


@pytest.fixture
def batch() -> TensorDict:
    return make_batch(6)


def test_every_loss_is_under_contract():
    public = {kind for kind in vars(library).values() if isinstance(kind, type)}
    assert {kind for kind in public if issubclass(kind, LossModule)} == {case.kind for case in CASES}


def test_construction_and_use_warn_of_nothing(case, batch):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        total(case()(batch)).backward()


def test_out_keys_are_what_is_written(case, batch):
    loss = case()
    out = loss(batch)
    assert set(out.keys()) == set(loss.out_keys)
    for key, value in out.items():
        assert value.requires_grad == key.startswith("loss_"), key


def test_each_term_reaches_the_networks(case, batch):
    loss = case()
    names = list(losses(loss(batch.clone())))
    for name in names:
        loss.zero_grad()
        loss(batch.clone())[name].backward()
        assert any(g.any() for g in gradients(loss).values()), name


def test_in_keys_are_complete(case, batch):
    loss = case()
    assert_same(loss(batch.select(*loss.in_keys)), loss(batch.clone()))


def test_every_in_key_counts(case, batch):
    """Without it there is an error, or, of masks and weights, another number."""
    loss = case()
    expected = loss(batch.clone())
    for key in (key for key in loss.in_keys if key != UNREAD):
        try:
            out = loss(batch.exclude(key))
        except ConfigError as error:
            assert str(key[-1] if isinstance(key, tuple) else key) in str(error)
            continue
        assert any(not torch.equal(out[name], expected[name]) for name in losses(out)), key


def test_every_accepted_key_can_be_set(case, batch):
    """All names nested at once: networks and batch follow, and so do the numbers."""
    expected = case()(batch.clone())
    names: Names = {field.name: ("set", f"my_{field.name}") for field in fields(case.kind.default_keys)}
    below_next = {"reward", "done", "terminated"}
    renamed = batch.clone()
    for name, key in names.items():
        prefix = ("next",) if name in below_next else ()
        old, new = unravel_key((*prefix, name)), unravel_key((*prefix, key))
        if old in renamed.keys(True):
            renamed.rename_key_(old, new)
    loss = case(names)
    assert_same(loss(renamed), expected)
    for key in (key for key in loss.in_keys if "observation" not in key):
        assert "set" in key


def test_unknown_keys_are_refused(case):
    with pytest.raises(ValueError, match="colour"):
        case().set_keys(colour="red")


def test_dispatch_equals_the_call_with_a_tensordict(case, batch):
    loss = case()
    expected = loss(batch.clone())
    named = {key if isinstance(key, str) else "_".join(key): batch[key] for key in loss.in_keys}
    found = loss(**named)
    found = found if isinstance(found, tuple) else (found,)
    assert_same(dict(zip(loss.out_keys, found, strict=True)), expected)


def test_some_out_keys_can_be_selected(case, batch):
    loss = case()
    name = loss.out_keys[0]
    expected = loss(batch.clone())[name]
    loss.select_out_keys(name)
    assert loss.out_keys == [name]
    assert_same(loss(batch), {name: expected})
    named = {key if isinstance(key, str) else "_".join(key): batch[key] for key in loss.in_keys}
    torch.testing.assert_close(loss(**named), expected)


def test_reductions_agree(case, batch):
    batch = batch.exclude("priority_weight")
    each, added, mean = (losses(case(reduction=r)(batch.clone())) for r in ("none", "sum", "mean"))
    counted = {"bc": batch["has_expert"], "aux": batch["has_goal"], "qvalue": ~batch["perturbed"]}
    for name, values in each.items():
        assert values.shape == batch.shape
        mask = counted.get(name.rpartition("_")[2], torch.ones(6, 1, dtype=torch.bool)).squeeze(-1)
        assert not values[~mask].any()
        torch.testing.assert_close(added[name], values.sum())
        torch.testing.assert_close(mean[name], values.sum() / mask.sum())


def test_weights_scale_each_sample(case, batch):
    plain = losses(case(reduction="none")(batch.exclude("priority_weight")))
    weighted = losses(case(reduction="none")(batch.clone()))
    for name, values in plain.items():
        torch.testing.assert_close(weighted[name], values * batch["priority_weight"])
    loss = case()
    loss.use_prioritized_weights = False
    assert "priority_weight" not in loss.in_keys
    assert_same(loss(batch.clone()), case()(batch.exclude("priority_weight")))


def test_weights_can_be_switched_off_at_construction(case, batch):
    assert_same(case(use_prioritized_weights=False)(batch.clone()), case()(batch.exclude("priority_weight")))
    for given in (True, "auto"):
        assert_same(case(use_prioritized_weights=given)(batch.clone()), case()(batch.clone()))


def test_no_reduction_named_is_the_mean(case, batch):
    assert case(reduction=None).reduction == "mean"
    assert_same(case(reduction=None)(batch.clone()), case()(batch.clone()))


def test_a_lazy_stack_is_a_batch(case, batch):
    """As collectors hand over what they gathered row by row; priorities are written into it too."""
    loss, lazy, dense = case(), lazy_stack(list(batch.clone().unbind(0))), batch.clone()
    assert_same(loss(lazy), loss(dense))
    assert ("td_error" in dense) == ("td_error" in lazy)
    if "td_error" in dense:
        torch.testing.assert_close(lazy["td_error"], dense["td_error"])


@pytest.mark.parametrize("randomness", ["error", "same", "different"])
def test_the_randomness_of_vmap_can_be_set(case, batch, randomness):
    """Nothing is mapped here, so it changes nothing."""
    loss = case()
    loss.set_vmap_randomness(randomness)
    assert loss.vmap_randomness == randomness
    assert_same(loss(batch.clone()), case()(batch.clone()))


def test_uniform_weights_change_no_mean(case, batch):
    expected = case()(batch.exclude("priority_weight"))
    batch["priority_weight"] = torch.full((6,), 0.25)
    assert_same(case()(batch), expected)


@pytest.mark.parametrize("weighted", [True, False])
def test_torchrls_own_validity_mask_counts(case, batch, weighted):
    """Padding of collectors, `("collector", "mask")`, is as if it were not there."""
    batch = batch if weighted else batch.exclude("priority_weight")
    expected = losses(case()(batch[:4].clone()))
    batch["collector", "mask"] = (torch.arange(6) < 4)[:, None]
    batch["expert_action"][4:] = torch.nan
    found = losses(case()(batch))
    assert_same(found, expected)


@pytest.mark.parametrize("shape", [(), (1,), (2, 3), (1, 2, 3)])
def test_any_batch_shape_is_welcome(case, shape):
    loss = case(reduction="none")
    batch = make_batch(*shape)
    flat = losses(loss(batch.reshape(-1).clone()))
    for name, values in losses(loss(batch)).items():
        assert values.shape == shape
        torch.testing.assert_close(values.reshape(-1), flat[name])


def test_nothing_labelled_gives_zeros_with_a_graph(case, batch):
    for mask in ("has_expert", "has_goal"):
        batch[mask] = torch.zeros(6, 1, dtype=torch.bool)
    batch["perturbed"] = torch.ones(6, 1, dtype=torch.bool)
    loss = case()
    out = losses(loss(batch))
    total(out).backward()
    assert all(value == 0 for name, value in out.items() if not name.endswith("ddpg"))
    assert all(g.isfinite().all() for g in gradients(loss).values())


def test_labels_outside_their_masks_may_be_anything(case, batch):
    expected_loss, loss = case(), case()
    expected = expected_loss(batch.clone())
    for label, mask in (("expert_action", "has_expert"), ("goal", "has_goal")):
        batch[label] = torch.where(batch[mask], batch[label], torch.nan)
    out = loss(batch)
    assert_same(out, expected)
    total(out).backward()
    total(expected).backward()
    assert_same(gradients(loss), gradients(expected_loss))


def test_state_dict_makes_another_loss_the_same(case, batch):
    first, second = case(), case()
    with torch.no_grad():
        for tensor in first.state_dict().values():
            if isinstance(tensor, Tensor) and tensor.is_floating_point():
                tensor.mul_(0.9)
    assert any(not torch.equal(first(batch.clone())[k], v) for k, v in second(batch.clone()).items())
    second.load_state_dict(first.state_dict())
    assert_same(second(batch.clone()), first(batch.clone()))


@pytest.mark.parametrize("copy", [deepcopy, lambda loss: pickle.loads(pickle.dumps(loss))])
def test_copies_are_equal_and_apart(case, batch, copy):
    loss = case()
    expected = loss(batch.clone())
    other = copy(loss)
    assert_same(other(batch.clone()), expected)
    with torch.no_grad():
        for parameter in other.parameters():
            parameter.zero_()
    assert_same(loss(batch.clone()), expected)


def test_moves_reach_every_tensor(case, batch):
    """A dtype shows it on any machine; devices go the same way, by parameters and buffers alone."""
    loss = case().to(torch.float64)
    assert not any(isinstance(value, Tensor) for m in loss.modules() for value in vars(m).values())
    halves = [t for t in (*loss.parameters(), *loss.buffers()) if t.is_floating_point()]
    assert {t.dtype for t in halves} == {torch.float64}
    double = batch.apply(lambda t: t.double() if t.is_floating_point() else t)
    found = loss(double)
    assert {value.dtype for value in found.values()} == {torch.float64}
    assert_same(found.float(), case()(batch))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
def test_networks_of_any_precision_meet_labels_of_float32(case, batch, dtype):
    """What the networks read has their type; labels, rewards and weights stay as they were recorded."""
    expected = case()(batch.clone())
    loss = case().to(dtype)
    for key in ("observation", "action", ("next", "observation")):
        batch[key] = batch[key].to(dtype)
    out = loss(batch)
    tolerance = 0.05 if dtype == torch.bfloat16 else 1e-5
    for key, value in out.items():
        assert not key.startswith("loss_") or value.dtype in (torch.float32, torch.float64)
        torch.testing.assert_close(value, expected[key], rtol=tolerance, atol=tolerance, check_dtype=False)
    total(out).backward()
    assert {gradient.dtype for gradient in gradients(loss).values()} == {dtype}


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int64, torch.float32])
def test_masks_of_any_type_are_true_where_they_are_not_zero(case, batch, dtype):
    expected = case()(batch.clone())
    for key in MASKS:
        batch[key] = 2 * batch[key].to(dtype)
    assert_same(case()(batch), expected)


def test_a_shape_that_would_broadcast_is_refused(case, batch):
    """Of rewards, ends and masks: (B,) beside (B, 1) would make (B, B)."""
    reads = {key for key in case().in_keys if key in (*MASKS, ("next", "reward"))}
    assert reads
    for key in reads:
        for wrong in (batch[key].squeeze(-1), batch[key].expand(6, 2)):
            name = key[-1] if isinstance(key, tuple) else key
            with pytest.raises(ConfigError, match=rf"'{name}' has the shape .* give \(6, 1\)"):
                case()(batch.clone().set(key, wrong))


@pytest.mark.parametrize("name", ["action", "state_action_value", "goal_prediction"])
def test_a_network_that_writes_other_keys_is_told_apart(name):
    """Wherever an output is absent, the error names it and set_keys."""
    outputs = {GoalAuxLoss: {"goal_prediction"}, PoseBCLoss: {"action", "goal_prediction"}}
    for case in CASES:
        if name in outputs.get(case.kind, {"state_action_value"}):
            loss = case()
            loss.set_keys(**{name: "elsewhere"})
            batch = make_batch(6)
            batch["elsewhere"] = batch["action"]
            with pytest.raises(ConfigError, match=rf"'elsewhere', which its network .* set_keys\({name}="):
                loss(batch)


def test_modes_reach_the_networks(case):
    loss = case()
    loss.eval()
    networks = [value for value in vars(loss).values() if isinstance(value, nn.Module)]
    assert networks
    assert not any(module.training for network in networks for module in network.modules())


def test_gradients_of_every_sample_by_vmap(case, batch):
    """With vmap over torch.func.grad, as many gradients as samples, each that of the sample alone."""
    loss = case()
    params = {name: p.detach() for name, p in loss.named_parameters()}

    def of_one(params: dict[str, Tensor], sample: TensorDict) -> Tensor:
        with TensorDict(params).unflatten_keys(".").to_module(loss):
            return total(loss(sample))

    found = torch.func.vmap(torch.func.grad(of_one), (None, 0))(params, batch)
    for row, sample in enumerate(batch.unbind(0)):
        loss.zero_grad()
        total(loss(sample.clone())).backward()
        for name, gradient in gradients(loss).items():
            torch.testing.assert_close(found[name][row], gradient)


@pytest.mark.parametrize(
    "case",
    [pytest.param(each, marks=[pytest.mark.slow] * (each.kind is not GoalAuxLoss)) for each in CASES],
    ids=lambda case: case.kind.__name__,
    indirect=True,
)
def test_compiled_whole_it_computes_the_same(case, batch):
    loss, plain = case(), case()
    compiled = torch.compile(loss, backend="aot_eager", fullgraph=True)
    found, expected = compiled(batch.clone()), plain(batch.clone())
    assert_same(found, expected)
    total(found).backward()
    total(expected).backward()
    assert_same(gradients(loss), gradients(plain))


def test_wrong_options_say_what_to_do(case):
    with pytest.raises(ConfigError, match="average"):
        case(reduction="average")
    with pytest.raises(ConfigError, match="use_prioritized_weights='always'"):
        case(use_prioritized_weights="always")
