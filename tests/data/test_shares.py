import pytest

from torchgrasp.data import anneal_shares, share_batch, split_batch
from torchgrasp.data.shares import check_shares
from torchgrasp.errors import ConfigError


def test_paper_batch_is_175_online_and_75_expert():
    assert split_batch(250, {"online": 0.7, "expert": 0.3}) == {"online": 175, "expert": 75}


def test_three_sources_by_largest_remainder():
    # 10 * (0.45, 0.33, 0.22) = 4.5, 3.3, 2.2: the one row left goes to the remainder 0.5.
    assert split_batch(10, {"a": 0.45, "b": 0.33, "c": 0.22}) == {"a": 5, "b": 3, "c": 2}


def test_ties_go_to_the_source_named_first():
    assert split_batch(7, {"a": 0.5, "b": 0.5}) == {"a": 4, "b": 3}


def test_counts_add_up_and_are_within_one_of_the_share():
    shares = {"a": 0.61, "b": 0.28, "c": 0.11}
    for batch_size in range(1, 400):
        counts = split_batch(batch_size, shares)
        assert sum(counts.values()) == batch_size
        assert all(abs(counts[name] - batch_size * shares[name]) < 1 for name in shares)


def test_annealing_is_linear_and_clamped():
    start, end = {"a": 0.2, "b": 0.8}, {"a": 0.6, "b": 0.4}
    assert anneal_shares(start, end, 0.25) == pytest.approx({"a": 0.3, "b": 0.7})
    assert anneal_shares(start, end, -1.0) == start
    assert anneal_shares(start, end, 2.0) == end


@pytest.mark.parametrize("shares", [{}, {"a": 0.7, "b": 0.2}, {"a": 1.5, "b": -0.5}, {"a": float("nan")}])
def test_shares_that_are_none_are_refused(shares):
    with pytest.raises(ConfigError):
        check_shares(shares)


def test_the_own_source_gets_its_fraction_and_the_others_share_the_rest_by_weight():
    shares = share_batch("online", 0.7, {"expert": 50, "failed": 100})
    assert shares == pytest.approx({"online": 0.7, "expert": 0.1, "failed": 0.2})
