"""Which rows of a folder of demonstrations teach, and what."""

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from torchgrasp.data import DemonstrationSource, without_expert
from torchgrasp.errors import ConfigError

FLAGS = ("has_expert", "has_goal")


def make_rows():
    success = torch.tensor([[True], [False], [True]])
    flags = {key: torch.ones(3, 1, dtype=torch.bool) for key in FLAGS}
    return TensorDict({**flags, "episode_success": success, "x": torch.arange(3)}, [3])


@pytest.mark.parametrize(("count", "kept"), [("all", [0, 1, 2]), ("successful", [0, 2]), ("failed", [1])])
def test_rows_are_those_of_the_episodes_that_count(count, kept):
    rows = DemonstrationSource("expert", Path("demos"), count).choose(make_rows())
    assert rows["x"].tolist() == kept
    assert all(bool(rows[key].all()) for key in FLAGS)


def test_a_source_without_labels_teaches_neither_actions_nor_goals():
    rows = DemonstrationSource("failed", Path("demos"), "all", labels=False).choose(make_rows())
    assert not any(bool(rows[key].any()) for key in FLAGS)


def test_steps_without_an_expert_keep_their_goals():
    steps = without_expert(make_rows())
    assert not steps["has_expert"].any() and bool(steps["has_goal"].all())


def test_a_count_that_is_unknown_is_refused():
    with pytest.raises(ConfigError, match="'best'"):
        DemonstrationSource("expert", Path("demos"), "best").choose(make_rows())
