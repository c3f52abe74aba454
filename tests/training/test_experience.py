"""What a run learns from: shares of demonstrations and of its own episodes, labels, priorities, memory."""

import pytest

from tests.data.rollouts import append, make_episodes
from torchgrasp.data import CompactTransitions, DemonstrationSource, Priority, open_demonstrations
from torchgrasp.errors import ConfigError
from torchgrasp.training import Experience


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
