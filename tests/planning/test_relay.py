"""One policy begins, another one ends: whose turn it is, and what each gets to see."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from torchgrasp.envs import GraspEnv
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.planning import NO_PLANNER, ExpertPolicy, OpenLoopPolicy, PlanStatus, RandomAction, Relay
from torchgrasp.sim import CameraIntrinsics, RaycastCamera

HORIZON = 20


class Constant(TensorDictModuleBase):
    """Always the same action; keeps the (world, episode, elapsed steps) that it was shown."""

    def __init__(self, value: float) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["world", "episode", "time_left"], ["action"]
        self.value, self.seen = value, set()

    def forward(self, tensordict: TensorDict) -> TensorDict:
        elapsed = ((1 - tensordict["time_left"]) * HORIZON).round().long()
        moment = torch.cat((tensordict["world"], tensordict["episode"], elapsed), -1)
        self.seen |= {tuple(each) for each in moment.reshape(-1, 3).tolist()}
        return tensordict.set("action", torch.full((*tensordict.batch_size, 6), self.value))


def episodes(worlds: int, numbers: int) -> TensorDict:
    """(worlds, numbers, HORIZON) moments."""
    shape = (worlds, numbers, HORIZON)
    time_left = (1 - torch.arange(HORIZON) / HORIZON).expand(shape)
    world = torch.arange(worlds)[:, None, None].expand(shape)
    number = torch.arange(numbers)[None, :, None].expand(shape)
    entries = {"time_left": time_left, "world": world, "episode": number}
    return TensorDict({name: entry[..., None].clone() for name, entry in entries.items()}, shape)


def make_relay(steps, **options) -> Relay:
    return Relay(Constant(1.0), Constant(2.0), steps=steps, horizon=HORIZON, **options)


def test_the_first_acts_for_its_steps_and_the_second_in_the_rest():
    acted = make_relay(7)(episodes(3, 2))
    expected = torch.where(torch.arange(HORIZON) < 7, 1.0, 2.0)
    assert torch.equal(acted["action"], expected[:, None].expand(3, 2, HORIZON, 6))
    assert torch.equal(acted["turn"][..., 0], (expected == 2.0).long().expand(3, 2, HORIZON))


@pytest.mark.parametrize(("steps", "value"), [(0, 2.0), (HORIZON, 1.0)])
def test_one_of_them_may_act_alone(steps, value):
    relay = make_relay(steps)
    assert torch.all(relay(episodes(2, 2))["action"] == value)
    assert not (relay.second if steps else relay.first).seen


def test_neither_sees_an_episode_out_of_its_turn():
    relay, batch = make_relay((3, 9)), episodes(6, 5)
    for t in range(HORIZON):  # as an environment would call it
        relay(batch[:, :, t].clone())
    first, second = relay.first.seen, relay.second.seen
    assert not first & second and len(first | second) == 6 * 5 * HORIZON
    for world in range(6):
        for number in range(5):
            mine = [t for w, e, t in first if (w, e) == (world, number)]
            assert sorted(mine) == list(range(len(mine))) and 3 <= len(mine) <= 9


def test_steps_are_drawn_uniformly_with_both_ends():
    lengths = (make_relay((0, 4))(episodes(40, 40))["turn"][..., 0] == 0).sum(-1)
    shares = torch.bincount(lengths.flatten(), minlength=5) / lengths.numel()
    assert len(shares) == 5 and shares == pytest.approx([0.2] * 5, abs=0.04)


def test_draws_belong_to_the_episode_whatever_the_batch():
    whole = make_relay((0, HORIZON), seed=3)(episodes(4, 4))
    part = make_relay((0, HORIZON), seed=3)(episodes(4, 4)[2:, 1, 5])
    assert torch.equal(part["turn"], whole["turn"][2:, 1, 5])
    single = make_relay((0, HORIZON), seed=3)(episodes(4, 4)[3, 3, 9])
    assert torch.equal(single["turn"], whole["turn"][3, 3, 9])
    assert torch.equal(single["action"], whole["action"][3, 3, 9])
    other = make_relay((0, HORIZON), seed=4)(episodes(4, 4))
    assert not torch.equal(other["turn"], whole["turn"])


@pytest.fixture(scope="module")
def grasping():
    torch.set_num_threads(1)
    objects = ProceduralObjects("train", num_objects=4, num_grasps=200)
    camera = RaycastCamera(CameraIntrinsics(4, 4))
    return objects, GraspEnv(4, objects=objects, camera=camera, horizon=30, seed=0)


def roll_out(env: GraspEnv, relay: Relay) -> TensorDict:
    env.start_episodes_at([0] * 4)
    return env.rollout(30, relay, break_when_any_done=False, break_when_all_done=True)


def test_the_expert_ends_what_a_plan_began(grasping):
    objects, env = grasping
    expert, planning = ExpertPolicy(objects, horizon=30), OpenLoopPolicy(objects, horizon=30)
    steps = roll_out(env, Relay(planning, expert, steps=20, horizon=30))
    alone = roll_out(env, OpenLoopPolicy(objects, horizon=30))
    assert torch.equal(steps["action"][:, :20], alone["action"][:, :20])
    assert torch.all(steps["plan_status"] == PlanStatus.OK.number)
    assert steps["next", "reward"][:, -1].sum() >= 3


def test_who_has_no_planner_says_so(grasping):
    objects, env = grasping
    relay = Relay(RandomAction(), ExpertPolicy(objects, horizon=30), steps=(2, 6), horizon=30)
    steps = roll_out(env, relay)
    assert torch.equal(steps["plan_status"] == NO_PLANNER, steps["turn"] == 0)


@pytest.mark.parametrize("steps", [-1, HORIZON + 1, (3, 2), (0, HORIZON + 1), (1, 2, 3), (), 2.5, (0, 0.5)])
def test_impossible_steps_are_refused(steps):
    with pytest.raises(ConfigError, match=f"^steps=.*horizon={HORIZON}"):
        make_relay(steps)
