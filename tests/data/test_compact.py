import pytest
import torch
from torchrl.collectors.utils import split_trajectories

from tests.data.rollouts import make_cloud, make_rollout, make_steps
from torchgrasp.data import CompactTransitions, MixtureReplayBuffer
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import gripper_control_points

LABELS = ("action", "expert_action", "goal", "has_expert", "has_goal", "perturbed", "points", "time_left")
OUTCOMES = ("reward", "terminated", "done")


def make_buffer(capacities=None, shares=None, **options):
    capacities = capacities or {"online": 1000, "expert": 1000}
    shares = shares or {"online": 0.5, "expert": 0.5}
    return MixtureReplayBuffer(capacities, shares, batch_size=64, **options)


def remember(reference, rollout, source=0):
    for step in rollout.reshape(-1).unbind(0):
        reference[step["time_left"].item()] = (step, source)


def check_against(reference, batch):
    """Every sampled transition equals the one of the dense rollout, next state included."""
    for row in batch.unbind(0):
        step, source = reference[row["time_left"].item()]
        assert row["source"].item() == source
        assert all(torch.equal(row[key], step[key]) for key in LABELS)
        assert all(torch.equal(row["next", key], step["next", key]) for key in OUTCOMES)
        if not step["next", "terminated"]:
            assert torch.equal(row["next", "points"], step["next", "points"])
            assert torch.equal(row["next", "time_left"], step["next", "time_left"])


def test_next_states_are_exact_whatever_wraps_and_wherever_rollouts_are_cut():
    generator = torch.Generator().manual_seed(0)
    buffer, reference = make_buffer({"online": 61, "expert": 37}), {}
    for call in range(60):
        num_envs, num_steps = torch.randint(1, 9, (2,), generator=generator).tolist()
        source = call % 3 == 0
        rollout = make_rollout(num_envs, num_steps, generator=generator, first_state=call * 1000)
        remember(reference, rollout, source)
        buffer.extend(rollout, source="expert" if source else "online")
        check_against(reference, buffer.sample())


def test_no_transition_is_lost():
    generator = torch.Generator().manual_seed(1)
    rollout = make_rollout(7, 40, generator=generator)
    buffer, reference = make_buffer(), {}
    remember(reference, rollout)
    buffer.extend(rollout)
    assert buffer.num_rows() == {"online": 280, "expert": 0}
    assert set(buffer.sample(6000)["time_left"].squeeze(-1).tolist()) == set(reference)


def test_only_cuts_cost_a_further_row():
    # Two rows of four steps: the first terminates, the second is truncated after two and cut at the end.
    done = torch.tensor([[0, 0, 0, 1], [0, 1, 0, 0]]).bool()
    truncated = torch.tensor([[0, 0, 0, 0], [0, 1, 0, 0]]).bool()
    state = torch.tensor([[0, 1, 2, 3], [10, 11, 20, 21]])
    rows = CompactTransitions().encode(make_steps(state, done, truncated, torch.Generator()))
    assert rows["time_left"].squeeze(-1).tolist() == [0, 1, 2, 3, 10, 11, 12, 20, 21, 22]
    assert rows["stub"].squeeze(-1).nonzero().squeeze(-1).tolist() == [6, 9]
    assert torch.equal(rows["points"][6].float(), make_cloud(torch.tensor(12))[:8, :3])


def test_padded_trajectories_are_stored_without_their_padding():
    generator = torch.Generator().manual_seed(2)
    rollout = make_rollout(3, 20, generator=generator)
    reference, buffer = {}, make_buffer()
    remember(reference, rollout)
    padded = split_trajectories(rollout, done_key="done")
    assert padded.numel() > rollout.numel()
    buffer.extend(padded)
    assert buffer.num_rows()["online"] == rollout.numel()
    check_against(reference, buffer.sample())


def test_one_rollout_without_a_batch_dimension():
    rollout = make_rollout(1, 12, generator=torch.Generator().manual_seed(3))[0]
    buffer, reference = make_buffer(), {}
    remember(reference, rollout)
    buffer.extend(rollout)
    check_against(reference, buffer.sample())


def test_rollouts_of_different_workers_are_not_joined():
    rollout = make_rollout(1, 6, generator=torch.Generator().manual_seed(4), done_rate=0.0)
    rollout["collector", "traj_ids"] = torch.tensor([[0, 0, 0, 1, 1, 1]])
    rows = CompactTransitions().encode(rollout)
    assert rows["stub"].squeeze(-1).tolist() == [False, False, False, True, False, False, False, True]


def test_missing_labels_are_stored_as_absent():
    rollout = make_rollout(2, 5, generator=torch.Generator().manual_seed(5))
    bare = rollout.exclude("expert_action", "goal", "has_expert", "has_goal", "perturbed")
    buffer = make_buffer()
    buffer.extend(bare)
    batch = buffer.sample()
    assert not batch["has_expert"].any() and not batch["has_goal"].any() and not batch["perturbed"].any()
    assert torch.equal(batch["goal"], torch.zeros(64, 7))


def test_extra_keys_are_kept():
    rollout = make_rollout(2, 5, generator=torch.Generator().manual_seed(6))
    rollout["object_id"] = rollout["time_left"].long()
    buffer = make_buffer(codec=CompactTransitions(extra_keys=("object_id",)))
    buffer.extend(rollout)
    batch = buffer.sample()
    assert torch.equal(batch["object_id"], batch["time_left"].long())


def test_an_example_row_holds_extra_keys_of_their_types():
    codec = CompactTransitions(extra_keys=("object_id", ("camera", "depth")))
    shapes = {"points": (14, 4), "time_left": (1,), "object_id": (1,), ("camera", "depth"): (2, 3)}
    row = codec.example_row(shapes, dtypes={"object_id": torch.int64})
    assert row["object_id"].dtype == torch.int64 and row["object_id"].shape == (1, 1)
    assert row["camera", "depth"].dtype == torch.float32 and row["camera", "depth"].shape == (1, 2, 3)
    for key in ("time_left", "object_id"):
        with pytest.raises(ConfigError, match=f"'{key}'"):
            codec.example_row({each: shape for each, shape in shapes.items() if each != key})


def test_extra_keys_that_are_missing_are_named():
    rollout = make_rollout(1, 4, generator=torch.Generator().manual_seed(6))
    with pytest.raises(ConfigError, match="finds no 'object_id'"):
        CompactTransitions(extra_keys=("object_id",)).encode(rollout)


def test_extra_keys_that_are_stored_anyway_change_nothing():
    rollout = make_rollout(2, 5, generator=torch.Generator().manual_seed(6))
    bare = rollout.exclude("goal", "perturbed")
    named = CompactTransitions(extra_keys=("goal", "perturbed", "episode_success", "time_left", "reward"))
    assert (named.encode(bare) == CompactTransitions().encode(bare)).all()


def test_a_stub_carries_the_goal_of_the_state_that_it_holds():
    generator = torch.Generator().manual_seed(12)
    rollout = make_rollout(1, 4, generator=generator, done_rate=0.0)
    rollout["next", "goal"] = torch.randn(1, 4, 7, generator=generator)
    rollout["next", "has_goal"] = ~rollout["has_goal"]
    rows = CompactTransitions().encode(rollout)
    assert torch.equal(rows["goal"][:4], rollout["goal"][0])
    assert torch.equal(rows["goal"][4], rollout["next", "goal"][0, 3])
    assert torch.equal(rows["has_goal"][4], rollout["next", "has_goal"][0, 3])
    # Without a next goal the last one known stays.
    rows = CompactTransitions().encode(rollout.exclude(("next", "goal"), ("next", "has_goal")))
    assert torch.equal(rows["goal"][4], rollout["goal"][0, 3])


def test_no_success_is_stored_across_the_border_of_two_trajectories():
    rollout = make_rollout(1, 5, generator=torch.Generator().manual_seed(4), done_rate=0.0)
    for key in ("done", "terminated", "reward"):
        rollout["next", key][0, -1] = 1
    rollout["collector", "traj_ids"] = torch.tensor([[0, 0, 1, 1, 1]])
    rows = CompactTransitions().encode(rollout)
    assert rows["stub"].squeeze(-1).int().tolist() == [0, 0, 1, 0, 0, 0]
    assert rows["episode_success"].squeeze(-1).int().tolist() == [0, 0, 0, 1, 1, 1]


def test_a_step_alone_is_refused():
    step = make_rollout(1, 2, generator=torch.Generator())[0, 0]
    for refuse in (make_buffer().add, make_buffer().extend, CompactTransitions().encode):
        with pytest.raises(ConfigError, match=r"\(\*, T\), time last"):
            refuse(step)
    buffer = make_buffer()
    buffer.extend(step.unsqueeze(-1))
    assert buffer.num_rows()["online"] == 1


@pytest.mark.parametrize("shape", [(0,), (2, 0), (0, 4)])
def test_no_steps_add_nothing(shape):
    rollout = make_rollout(2, 4, generator=torch.Generator().manual_seed(0))
    buffer = make_buffer()
    empty = rollout[0, :0] if len(shape) == 1 else rollout[: shape[0], : shape[1]]
    assert empty.shape == shape
    index = buffer.extend(empty, source="expert")
    assert index.shape == (0,) and index.dtype == torch.int64
    padding = rollout.copy().set("mask", torch.zeros(2, 4, dtype=torch.bool))
    assert buffer.extend(padding).numel() == 0
    assert len(buffer) == 0
    buffer.extend(rollout)
    assert buffer.num_rows()["online"] == 8


def test_gripper_points_and_flags_come_back():
    rollout = make_rollout(1, 3, generator=torch.Generator().manual_seed(7))
    buffer = make_buffer()
    buffer.extend(rollout)
    points = buffer.sample()["points"]
    assert torch.equal(points[0, -6:, :3], gripper_control_points())
    assert points[..., 3].sum(-1).unique().tolist() == [6]


def test_clouds_without_gripper_points_are_refused_unless_asked_for():
    rollout = make_rollout(1, 3, generator=torch.Generator().manual_seed(7))
    rollout["points"] = rollout["points"][..., :8, :3]
    rollout["next", "points"] = rollout["next", "points"][..., :8, :3]
    with pytest.raises(ConfigError, match="AppendGripperPoints"):
        make_buffer().extend(rollout)
    buffer = make_buffer(codec=CompactTransitions(gripper_points=False))
    buffer.extend(rollout)
    assert buffer.sample()["next", "points"].shape == (64, 8, 3)


def test_points_on_disk_equal_points_in_memory(tmp_path):
    rollout = make_rollout(4, 20, generator=torch.Generator().manual_seed(8))
    batches = []
    for folder in (None, tmp_path):
        buffer = make_buffer(folder=folder)
        buffer.extend(rollout)
        batches.append(buffer.sample())
    assert (batches[0] == batches[1]).all()


def test_prefetching_threads_see_no_torn_transitions():
    generator = torch.Generator().manual_seed(9)
    buffer, reference = make_buffer({"online": 50, "expert": 50}, prefetch=2), {}
    for call in range(40):
        rollout = make_rollout(4, 8, generator=generator, first_state=call * 1000)
        remember(reference, rollout)
        buffer.extend(rollout)
        check_against(reference, buffer.sample())


def test_a_restored_buffer_samples_the_same():
    generator = torch.Generator().manual_seed(10)
    first = make_buffer({"online": 61, "expert": 37})
    for source in ("online", "expert", "online"):
        first.extend(make_rollout(4, 12, generator=generator), source=source)
    first.sample()
    second = make_buffer({"online": 61, "expert": 37}, seed=1)
    second.load_state_dict(first.state_dict())
    for _ in range(3):
        assert (first.sample() == second.sample()).all()
        rollout = make_rollout(2, 9, generator=generator)
        first.extend(rollout)
        second.extend(rollout)


def test_rows_can_be_encoded_first_and_stored_later():
    generator = torch.Generator().manual_seed(11)
    rollout = make_rollout(4, 12, generator=generator)
    direct, later = make_buffer(), make_buffer()
    direct.extend(rollout, source="expert")
    later.extend_rows(CompactTransitions().encode(rollout), source="expert")
    assert (direct.sample() == later.sample()).all()


def test_a_goal_that_the_critic_reads_comes_with_its_next_value():
    generator = torch.Generator().manual_seed(12)
    rollout = make_rollout(5, 30, generator=generator)
    rollout["next", "goal"] = torch.randn(5, 30, 7, generator=generator)
    # A goal of the next state is that of the step after it, where the episode goes on.
    goes_on = ~rollout["next", "done"][:, :-1].squeeze(-1)
    rollout["goal"][:, 1:][goes_on] = rollout["next", "goal"][:, :-1][goes_on]
    reference = {}
    remember(reference, rollout)
    buffer = make_buffer(codec=CompactTransitions(state_keys=("time_left", "goal")))
    buffer.extend(rollout)
    batch = buffer.sample()
    check_against(reference, batch)
    for row in batch.unbind(0):
        step, _ = reference[row["time_left"].item()]
        assert torch.equal(row["next", "goal"], step["next", "goal"]) or step["next", "terminated"]


def test_observations_that_are_missing_are_named():
    codec = CompactTransitions(state_keys=("time_left", "goal"))
    rollout = make_rollout(1, 6, generator=torch.Generator().manual_seed(13), done_rate=0.0)
    with pytest.raises(ConfigError, match=r"next.*goal.*last state of a cut rollout"):
        codec.encode(rollout)
    with pytest.raises(ConfigError, match="finds no 'goal'"):
        codec.encode(rollout.exclude("goal"))
    whole = rollout.clone()
    whole["next", "done"][0, -1] = whole["next", "terminated"][0, -1] = True
    assert len(codec.encode(whole)) == 6
    with pytest.raises(ConfigError, match="stores no observation"):
        CompactTransitions(points_key=None, state_keys=())


def test_flat_rollouts_are_stored_as_stacked_ones_are():
    # Two worlds of three steps: the first is cut, the second succeeds.
    state = torch.arange(6).reshape(2, 3)
    end = torch.zeros(2, 3, dtype=torch.bool)
    end[1, -1] = True
    rollout = make_steps(state, end, torch.zeros_like(end), torch.Generator().manual_seed(0))
    rollout["world"] = torch.arange(2)[:, None, None].expand(2, 3, 1)
    rollout["next", "reward"][1, -1] = 1.0
    stacked, flat = CompactTransitions().inv(rollout), CompactTransitions().inv(rollout.reshape(-1))
    for key in stacked.keys(True, True):
        assert torch.equal(stacked[key], flat[key]), key
    assert stacked["stub"].flatten().int().tolist() == [0, 0, 0, 1, 0, 0, 0]
    assert stacked["episode_success"].flatten().int().tolist() == [0, 0, 0, 0, 1, 1, 1]
