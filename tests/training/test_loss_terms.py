"""Means of loss terms over the updates between two rows, by hand."""

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.training import MeanTerms


def add(terms, network, **values):
    terms.add(network, TensorDict({name: torch.tensor(value) for name, value in values.items()}))


def test_means_by_network_and_term_in_the_order_in_which_they_came():
    terms = MeanTerms()
    for value in (1.0, 2.0, 6.0):
        add(terms, "critic", loss_qvalue=value, td_error=-value)
    add(terms, "actor", loss_bc=0.5)  # updated once
    means = terms.fetch()
    assert means == {"critic/loss_qvalue": 3.0, "critic/td_error": -3.0, "actor/loss_bc": 0.5}
    assert list(means)[-1] == "actor/loss_bc"


def test_they_begin_anew_when_they_are_fetched():
    terms = MeanTerms()
    assert terms.fetch() == {}
    add(terms, "actor", loss_bc=4.0)
    assert terms.fetch() == {"actor/loss_bc": 4.0} and terms.fetch() == {}
    add(terms, "actor", loss_bc=2.0)
    assert terms.fetch() == {"actor/loss_bc": 2.0}


def test_what_was_not_fetched_is_saved():
    first, second = MeanTerms(), MeanTerms()
    add(first, "actor", loss_bc=1.0)
    second.load_state_dict(first.state_dict())
    for terms in (first, second):
        add(terms, "actor", loss_bc=2.0)
    assert first.fetch() == second.fetch() == {"actor/loss_bc": 1.5}


def test_no_graph_is_kept_and_small_terms_are_added_up_exactly():
    terms, weight = MeanTerms(), torch.ones((), requires_grad=True)
    for _ in range(1000):
        terms.add("actor", TensorDict({"loss_bc": 0.1 * weight}))
    assert not terms.state_dict()["sums"]["actor/loss_bc"].requires_grad
    assert terms.fetch()["actor/loss_bc"] == pytest.approx(torch.tensor(0.1).item(), rel=1e-12)
