"""What a run learns from: shares of demonstrations and of its own episodes, labels, priorities, memory."""

import copy

import pytest
import torch

from tests.data.rollouts import append, make_episodes
from torchgrasp.data import CompactTransitions, DemonstrationSource, Priority, open_demonstrations
from torchgrasp.errors import ConfigError
from torchgrasp.training import Experience
from torchgrasp.transforms import RandomMirror


@pytest.fixture
def folder(tmp_path):
    """Two shards of demonstrations."""
    for index in range(2):
        append(tmp_path / "demos", index)
    return tmp_path / "demos"


def make_experience(**options) -> Experience:
    codec = CompactTransitions()
    row = codec.example_row({"points": (14, 4), "time_left": (1,)})
    given = {"capacity": 50, "batch_size": 10, "own_share": 0.7, "seed": 0, **options}
    return Experience("online", row=row, codec=codec, **given)


def source(folder, name="expert", count="all", **options) -> DemonstrationSource:
    return DemonstrationSource(name, folder, count, **options)


def test_a_batch_has_its_share_of_own_episodes_and_the_rest_of_demonstrations(folder):
    experience = make_experience()
    experience.make_buffer([source(folder)])
    experience.load_demonstrations()
    for episode in make_episodes(7):
        experience.add(episode)
    experience.draw_all()
    assert experience.buffer.shares == pytest.approx({"online": 0.7, "expert": 0.3})
    batch = experience.sample()
    assert batch.shape == (10,) and (batch["source"] == 0).sum() == 7
    assert experience.sample(4).shape == (4,)


def test_demonstrations_share_by_their_steps_or_their_weights(folder):
    card = open_demonstrations(folder).card
    good, bad, all_steps = (card[name] for name in ("successful_steps", "failed_steps", "steps"))
    assert good + bad == all_steps and good and bad
    experience = make_experience()
    experience.make_buffer([source(folder, count="successful"), source(folder, "failed", "failed")])
    experience.draw_all()
    expected = {"online": 0.7, "expert": 0.3 * good / all_steps, "failed": 0.3 * bad / all_steps}
    assert experience.buffer.shares == pytest.approx(expected)
    experience.make_buffer(
        [source(folder), source(folder, "failed", weight=0), source(folder, "c", weight=0)]
    )
    experience.draw_all()
    assert experience.buffer.shares == pytest.approx({"online": 0.7, "expert": 0.3, "failed": 0.0, "c": 0.0})


def test_imitation_draws_from_labelled_demonstrations_alone(folder):
    experience = make_experience()
    experience.make_buffer([source(folder), source(folder, "failed", "failed", labels=False)])
    experience.draw_demonstrations()
    assert experience.buffer.shares == pytest.approx({"online": 0.0, "expert": 1.0, "failed": 0.0})
    experience.draw_all(labelled=True)
    assert experience.buffer.shares == pytest.approx({"online": 0.7, "expert": 0.3, "failed": 0.0})


def test_without_room_for_own_episodes_nothing_is_drawn_from_them(folder):
    experience = make_experience(capacity=0)
    experience.make_buffer([source(folder)])
    experience.load_demonstrations()
    experience.draw_all()
    assert experience.buffer.shares == pytest.approx({"online": 0.0, "expert": 1.0})
    assert experience.sample().shape == (10,)


def test_sources_hold_the_rows_that_count(folder):
    experience = make_experience()
    experience.make_buffer([source(folder, count="successful"), source(folder, "failed", "failed")])
    experience.load_demonstrations()
    rows = experience.buffer.state_dict()["_storage"]["rows"]
    assert bool(rows["expert"]["episode_success"].all()) and not rows["failed"]["episode_success"].any()


def test_beta_rises_to_one_over_a_run(folder):
    experience = make_experience(priority=Priority(beta=0.4))
    experience.make_buffer([source(folder)])
    found = []
    for progress in (0.0, 0.5, 1.0):
        experience.anneal(progress)
        found.append(experience.buffer.beta)
    assert found == pytest.approx([0.4, 0.7, 1.0])
    uniform = make_experience()
    uniform.make_buffer([source(folder)])
    uniform.anneal(1.0)  # nothing to correct


def test_the_first_source_is_described_and_further_ones_by_name(folder):
    experience = make_experience()
    experience.make_buffer([source(folder), source(folder, "failed")])
    card = open_demonstrations(folder).card
    told = {name: card[name] for name in ("kind", "episodes", "successes", "steps", "bytes")}
    described = experience.describe()
    for each in (described["demonstrations"], described["more_demonstrations"]["failed"]):
        assert told.items() <= each.items()
    experience.make_buffer([source(folder)])
    assert set(experience.describe()) == {"demonstrations"}


def test_demonstrations_that_teach_nothing_or_are_of_another_shape_are_refused(folder):
    experience = make_experience()
    with pytest.raises(ConfigError, match="No demonstrations are left to learn from"):
        experience.make_buffer([source(folder, weight=0)])
    experience.make_buffer([source(folder, labels=False)])
    with pytest.raises(ConfigError, match="give one of them labels=true"):
        experience.draw_demonstrations()
    codec = CompactTransitions()
    row = codec.example_row({"points": (20, 4), "time_left": (1,)})
    other = Experience("online", row=row, codec=codec, capacity=5, batch_size=4, own_share=0.5, seed=0)
    with pytest.raises(ConfigError, match=r"hold 'points' of shape \(8, 3\), \(14, 3\) is wanted"):
        other.make_buffer([source(folder)])


def make_filled(folder, **options) -> Experience:
    experience = make_experience(**options)
    experience.make_buffer([source(folder)])
    experience.load_demonstrations()
    for episode in make_episodes(7):
        experience.add(episode)
    experience.draw_all()
    return experience


def assert_same(batches, others):
    for batch, other in zip(batches, others, strict=True):
        assert set(batch.keys(True, True)) == set(other.keys(True, True))
        assert bool((batch == other).all())


def test_batches_drawn_ahead_are_those_drawn_on_demand(folder):
    plain, ahead = (make_filled(folder, ahead=depth, augment=RandomMirror()) for depth in (0, 2))
    torch.manual_seed(0)  # of the mirrors
    expected = [*plain.batches(3), *(plain.sample() for _ in range(2)), *plain.batches(2, 4)]
    torch.manual_seed(0)
    assert_same([*ahead.batches(5), *ahead.batches(2, 4)], expected)


@pytest.mark.parametrize("ahead", [0, 2])
def test_a_state_knows_nothing_of_batches_that_nobody_has_taken(folder, ahead):
    whole, first, second = (make_filled(folder, ahead=ahead) for _ in range(3))
    batches = first.batches(6)
    taken = [next(batches) for _ in range(2)]
    second.load_state_dict(copy.deepcopy(first.state_dict()))
    expected = [*whole.batches(6)]
    assert_same([*taken, *batches], expected)  # the state was taken in between
    assert_same([*second.batches(4)], expected[2:])


def test_what_is_added_or_shared_anew_counts_from_the_next_batch_on(folder):
    plain, ahead = (make_filled(folder, ahead=depth) for depth in (0, 2))
    found = {}
    for name, experience in (("plain", plain), ("ahead", ahead)):
        batches = experience.batches(9)
        found[name] = [next(batches) for _ in range(3)]
        for episode in make_episodes(8):
            experience.add(episode)
        found[name] += [next(batches) for _ in range(3)]
        experience.draw_demonstrations()
        found[name] += [*batches]
    assert_same(found["ahead"], found["plain"])
    assert (found["ahead"][-1]["source"] == 1).all()


def test_with_a_priority_nothing_is_drawn_ahead(folder):
    experience = make_filled(folder, ahead=2, priority=Priority())
    for batch in experience.batches(2):
        batch["td_error"] = torch.rand(len(batch))
        experience.update_priorities(batch)
        assert "priority_weight" in batch
    assert experience._drawing is None
