"""The choices of conf/replay: what a learner stores and how it draws."""

import collect
import common
import pytest
import torch
from hydra.utils import instantiate
from learner import Learner
from runner import ROOT
from sources import Source
from tensordict import TensorDict

from torchgrasp.data import MixtureReplayBuffer, estimate_bytes
from torchgrasp.errors import ConfigError
from torchgrasp.transforms import HindsightGoal

# Observations that each preset stores, of shapes as its transforms would write them.
SHAPES = {"mixture": {"points": (14, 4)}, "prioritised": {"points": (14, 4)}, "images": {"image": (4, 8, 8)}}


def test_every_preset_is_tested():
    assert {file.stem for file in (ROOT / "conf" / "replay").glob("*.yaml")} == set(SHAPES)


@pytest.mark.parametrize(("preset", "shapes"), SHAPES.items())
def test_a_preset_makes_a_buffer_of_what_it_stores(composed, preset, shapes):
    chosen = [f"replay={preset}", "env.num_envs=1"]
    chosen += ["+transforms.image.channels=rgbd"] if preset == "images" else []
    cfg = composed(*chosen)
    codec, priority = instantiate(cfg.replay.codec), instantiate(cfg.replay.priority)
    assert codec.observation_keys == (*shapes, "time_left", "table_plane", "wrist_angle")
    row = codec.example_row({**shapes, "time_left": (1,), "table_plane": (4,), "wrist_angle": (1,)})
    options = {"batch_size": cfg.replay.batch_size, "codec": codec, "priority": priority, "row": row}
    buffer = MixtureReplayBuffer({"online": 10}, {"online": 1.0}, **options)
    buffer.extend_rows(
        torch.cat([row] * 5).set("source", torch.zeros(5, 1, dtype=torch.int64)), source="online"
    )
    batch = buffer.sample()
    assert batch.shape == (cfg.replay.batch_size,)
    assert (batch.get("priority_weight", None) is not None) == (preset == "prioritised")
    assert all(batch["next", key].shape[1:] == shape for key, shape in shapes.items())


def test_a_critic_that_reads_the_goal_has_its_next_value_stored(composed):
    codec = instantiate(composed("replay.codec.state_keys=[time_left,goal]").replay.codec)
    assert codec.observation_keys == ("points", "time_left", "goal")
    row = codec.example_row({"points": (14, 4), "time_left": (1,), "goal": (7,)})
    assert isinstance(row, TensorDict) and row["goal"].shape == (1, 7)


def test_hindsight_goals_are_an_override_away(composed):
    cfg = composed(
        "replay.augment={_target_: torchgrasp.transforms.HindsightGoal}", "+replay.augment.keep=true"
    )
    assert isinstance(instantiate(cfg.replay.augment), HindsightGoal)
    # What it reads is handed over by the workers.
    assert "T_base_ee" in common.KEPT


def test_the_correction_of_priorities_grows_to_the_full(composed, tmp_path):
    cfg = composed("experiment=smoke", "replay=prioritised", "demonstrations.steps=12")
    with common.make_pool(cfg) as pool:
        collect.collect(cfg, pool, tmp_path / "demos")
    learner = Learner(cfg, common.observed_shapes(cfg))
    learner.experience.make_buffer([Source("expert", tmp_path / "demos", "successful")])
    found = []
    for progress in (0.0, 0.5, 1.0):
        learner.set_rates(progress)
        found.append(learner.buffer.beta)
    assert found == pytest.approx([0.4, 0.7, 1.0])


def test_further_keys_of_a_step_are_an_override_away(composed, tmp_path):
    cfg = composed("experiment=smoke", "replay.codec.extra_keys=[T_base_ee]", "demonstrations.steps=12")
    with common.make_pool(cfg) as pool:
        collect.collect(cfg, pool, tmp_path / "demos")
    learner = Learner(cfg, common.observed_shapes(cfg))
    learner.experience.make_buffer([Source("expert", tmp_path / "demos", "successful")])
    learner.experience.load_demonstrations()
    # What was told of memory beforehand is what the rows take.
    assert learner.buffer.num_bytes() == estimate_bytes(len(learner.buffer), learner.experience.row)
    poses = learner.buffer.sample()["T_base_ee"]
    assert poses.shape[1:] == (4, 4) and (poses[:, 3, 3] == 1).all()
    # Demonstrations that lack what is wanted are refused before anything is stored.
    other = composed("experiment=smoke", "replay.codec.extra_keys=[T_base_ee,object_id]")
    with pytest.raises(ConfigError, match="object_id"):
        strict = Learner(other, common.observed_shapes(other))
        strict.experience.make_buffer([Source("expert", tmp_path / "demos", "successful")])
