"""The choices of conf/replay: what a run stores and how it draws, and what does not go together."""

import pytest
import torch
from tensordict import TensorDict

from tests.configurations import ROOT
from torchgrasp.config import LEARNED_FROM, make_row
from torchgrasp.config.networks import make_networks
from torchgrasp.config.parts import build
from torchgrasp.config.transition_storage import make_codec, make_experience
from torchgrasp.data import DemonstrationSource, MixtureReplayBuffer, estimate_bytes, open_demonstrations
from torchgrasp.errors import ConfigError
from torchgrasp.transforms import HindsightGoal

# Observations that each preset stores, of shapes as its transforms would write them.
STATE = {"time_left": (1,), "table_plane": (4,), "wrist_angle": (1,)}
SHAPES = {"mixture": {"points": (14, 4)}, "prioritised": {"points": (14, 4)}, "images": {"image": (4, 8, 8)}}
POINTS = {"points": (38, 4), **STATE}


def make(cfg, shapes, own="online"):
    return make_experience(cfg, make_networks(cfg.model), shapes, own=own)


def test_every_preset_is_tested():
    assert {file.stem for file in (ROOT / "conf" / "replay").glob("*.yaml")} == set(SHAPES)


@pytest.mark.parametrize(("preset", "shapes"), SHAPES.items())
def test_a_preset_makes_a_buffer_of_what_it_stores(composed, preset, shapes):
    cfg = composed(f"replay={preset}", *(["transforms=rgbd"] if preset == "images" else []))
    codec, priority = build(cfg.replay.codec), build(cfg.replay.priority)
    assert codec.observation_keys == (*shapes, *STATE)
    row = make_row(codec, None, {**shapes, **STATE})
    options = {"batch_size": cfg.replay.batch_size, "codec": codec, "priority": priority, "row": row}
    buffer = MixtureReplayBuffer({"online": 10}, {"online": 1.0}, **options)
    buffer.extend_rows(
        torch.cat([row] * 5).set("source", torch.zeros(5, 1, dtype=torch.int64)), source="online"
    )
    batch = buffer.sample()
    assert batch.shape == (cfg.replay.batch_size,)
    assert (batch.get("priority_weight", None) is not None) == (preset == "prioritised")
    assert all(batch["next", key].shape[1:] == shape for key, shape in shapes.items())


def test_a_network_that_reads_the_goal_has_its_next_value_stored(composed):
    cfg = composed("experiment=smoke", "model.critic.goal_input=true", "replay.codec.state_keys=[time_left]")
    codec = make_codec(cfg, make_networks(cfg.model).values())
    assert codec.observation_keys == ("points", "time_left", "goal")
    row = make_row(codec, None, POINTS)
    assert isinstance(row, TensorDict) and row["goal"].shape == (1, 7)


def test_the_next_goal_is_the_next_steps_label(composed, demonstrations):
    given = ["model.actor.goal_input=true", "model.critic.goal_input=true"]
    experience = make(composed("experiment=smoke", *given), POINTS)
    experience.make_buffer([DemonstrationSource("expert", demonstrations, "successful")])
    experience.load_demonstrations()
    experience.draw_demonstrations()
    batch = experience.sample(64)
    follows = []
    for rows in open_demonstrations(demonstrations).iterate_rows():
        goals, clock = rows["goal"], rows["time_left"].squeeze(-1)
        follows += [(goals[i], goals[i + 1]) for i in range(len(goals) - 1) if clock[i + 1] < clock[i]]
    here, after = (torch.stack(each) for each in zip(*follows, strict=True))
    on = ~batch["next", "terminated"].squeeze(-1)
    assert on.sum() > 10
    for goal, following in zip(batch["goal"][on], batch["next", "goal"][on], strict=True):
        same = (here == goal).all(dim=-1)
        assert (after[same] == following).all(dim=-1).any()


def test_hindsight_goals_are_an_override_away(composed):
    cfg = composed(
        "replay.augment={_target_: torchgrasp.transforms.HindsightGoal}", "+replay.augment.keep=true"
    )
    assert isinstance(build(cfg.replay.augment), HindsightGoal)
    # What it reads is handed over by the workers.
    assert "T_base_ee" in LEARNED_FROM


def test_further_keys_of_a_step_are_an_override_away(composed, collected):
    wanted = "replay.codec.extra_keys=[T_base_ee]"
    source = DemonstrationSource("expert", collected(wanted, "demonstrations.steps=12").path, "successful")
    shapes = {**POINTS, "T_base_ee": (4, 4), "object_id": (1,)}
    experience = make(composed("experiment=smoke", wanted), shapes)
    experience.make_buffer([source])
    experience.load_demonstrations()
    # What was told of memory beforehand is what the rows take.
    assert experience.buffer.num_bytes() == estimate_bytes(len(experience.buffer), experience.row)
    experience.draw_demonstrations()
    poses = experience.sample()["T_base_ee"]
    assert poses.shape[1:] == (4, 4) and (poses[:, 3, 3] == 1).all()
    # Demonstrations that lack what is wanted are refused before anything is stored.
    other = composed("experiment=smoke", "replay.codec.extra_keys=[T_base_ee,object_id]")
    with pytest.raises(ConfigError, match="object_id"):
        make(other, shapes).make_buffer([source])


def test_offline_leaves_no_room_for_episodes_that_nobody_runs(composed, demonstrations):
    experience = make(composed("experiment=smoke", "offline.updates=3"), POINTS)
    experience.make_buffer([DemonstrationSource("expert", demonstrations, "successful")])
    experience.draw_all()
    assert experience.buffer.shares == {"online": 0.0, "expert": 1.0}


@pytest.mark.parametrize(
    ("overrides", "shapes", "told"),
    [
        (["model=resnet18", "model.width=0.25"], POINTS, r"read \['image'\].*replay=images"),
        ([], STATE, r"write no \['points'\]"),
        (
            [],
            {"points": (38, 4), "time_left": (1,), "wrist_angle": (1,)},
            r"write no \['table_plane'\].*transforms\.table=\{_target_: torchgrasp\.transforms\.TablePlane\}",
        ),
        (
            ["model.state_inputs={joints: 9}"],
            POINTS,
            r"replay\.codec\.state_keys must name model\.state_inputs",
        ),
        (["model.state_inputs={wrist_angle: 2}"], POINTS, r"wrist_angle has the shape \(1,\)"),
        (["replay.online_capacity=1000000000000"], POINTS, "transitions would fit"),
        (["replay=prioritised", "replay.priority.alpha=2"], POINTS, r"^replay\.priority\.alpha=2"),
        (
            ["experiment=laptop", "model=resnet18", "model.width=0.25", "replay=images", "transforms=rgbd"],
            {"image": (4, 32, 32), **STATE},
            r"^replay\.augment: RandomMirror finds none",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(composed, overrides, shapes, told):
    with pytest.raises(ConfigError, match=told):
        make(composed(*overrides), shapes)
