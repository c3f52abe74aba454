"""Cells of Table 2 as whole runs: goals in the buffer, the goal network at evaluation and in the weights."""

import csv

import collect
import common
import policies
import pytest
import td3_bc
import torch
from evaluate import evaluate
from hydra.utils import instantiate
from learner import Learner
from networks import load_acting
from omegaconf import OmegaConf
from sources import Source
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential

from torchgrasp.data import open_demonstrations
from torchgrasp.errors import ConfigError
from torchgrasp.modules import GoalPredictor, GraspActor
from torchgrasp.runs.weights import load_weights, save_weights

CONDITIONED = ["model.actor.goal_input=true", "model.critic.goal_input=true"]


def find_run(root):
    (run_dir,) = root.glob("td3_bc/*")
    return run_dir


@pytest.mark.parametrize(
    ("overrides", "networks", "auxiliary"),
    [
        (
            [*CONDITIONED, "model.actor.goal_prediction=false", "model.critic.goal_prediction=false"],
            {"actor", "critic", "goal_network"},
            set(),
        ),
        (["model.critic.goal_input=true"], {"actor", "critic"}, {"actor", "critic"}),
        (
            ["model.actor.goal_input=true", "model.critic.goal_prediction=false"],
            {"actor", "critic", "goal_network"},
            {"actor"},
        ),
    ],
)
def test_a_cell_trains_and_is_evaluated(composed, tmp_path, overrides, networks, auxiliary):
    cfg = composed("experiment=smoke", "evaluation.baselines=[]", *overrides)
    summary = td3_bc.train(cfg)
    assert summary["episodes"] == 4 and summary["gradient_steps"] == 18
    run_dir = find_run(tmp_path)
    with (run_dir / "metrics.csv").open() as stream:
        columns = set(next(csv.reader(stream)))
    for name in ("actor", "critic"):
        assert (f"{name}/loss_{name}_aux" in columns) is (name in auxiliary)
    assert ("goal_network/loss_aux" in columns) is ("goal_network" in networks)
    assert set(load_weights(run_dir / "weights.safetensors")[0]) == networks
    options = ["episodes=4", "seed=1000", "evaluation.num_objects=4", "evaluation.num_envs=2"]
    options += ["objects.num_grasps=100", "collector.num_workers=0"]
    again = evaluate(composed(f"policy={run_dir}", *options, recipe="evaluate"))
    assert again["env_steps"] == summary["comparison"]["policy"]["env_steps"]
    assert again["objects"] == summary["objects"]


def test_the_next_goal_is_the_next_steps_label(composed, tmp_path):
    cfg = composed("experiment=smoke", "demonstrations.kind=expert", *CONDITIONED)
    with common.make_pool(cfg) as pool:
        collect.collect(cfg, pool, tmp_path / "demos")
    learner = Learner(cfg, common.observed_shapes(cfg))
    learner.experience.make_buffer([Source("expert", tmp_path / "demos", "successful")])
    learner.experience.load_demonstrations()
    learner.experience.draw_demonstrations()
    batch = learner.buffer.sample(64)
    follows = []
    for rows in open_demonstrations(tmp_path / "demos").iterate_rows():
        goals, clock = rows["goal"], rows["time_left"].squeeze(-1)
        follows += [(goals[i], goals[i + 1]) for i in range(len(goals) - 1) if clock[i + 1] < clock[i]]
    here, after = (torch.stack(each) for each in zip(*follows, strict=True))
    on = ~batch["next", "terminated"].squeeze(-1)
    assert on.sum() > 10
    for goal, following in zip(batch["goal"][on], batch["next", "goal"][on], strict=True):
        same = (here == goal).all(dim=-1)
        assert (after[same] == following).all(dim=-1).any()
    metrics = learner.imitate(batch)
    assert metrics["goal_network/loss_aux"] > 0


def test_a_resumed_goal_network_goes_on(composed, tmp_path):
    cfg = composed("experiment=smoke", *CONDITIONED)
    with common.make_pool(cfg) as pool:
        collect.collect(cfg, pool, tmp_path / "demos")
    first, second = (Learner(cfg, common.observed_shapes(cfg)) for _ in range(2))
    for learner in (first, second):
        learner.experience.make_buffer([Source("expert", tmp_path / "demos", "successful")])
    first.experience.load_demonstrations()
    first.experience.draw_demonstrations()
    first.imitate(first.buffer.sample(8))
    first.checkpoint(tmp_path)
    assert second.resume(tmp_path)
    for name, value in first.networks["goal_network"].state_dict().items():
        assert torch.equal(second.networks["goal_network"].state_dict()[name], value)
    assert second.optimizers["goal_network"].state_dict()["state"]


def test_weights_bring_the_goal_network_and_no_file_of_their_own(composed, tmp_path):
    """Public weights that a run began with need not be there when its policy is loaded."""
    cfg = composed("experiment=smoke", "model=resnet18", "model.width=0.25", *CONDITIONED)
    networks = {name: instantiate(cfg.model[name]) for name in ("actor", "critic", "goal_network")}
    plain = OmegaConf.to_container(cfg, resolve=True)
    for each in (plain["model"], *(plain["model"][name] for name in networks)):
        each["encoder"]["weights"] = "/nowhere/resnet18.safetensors"
    save_weights(tmp_path / "w.safetensors", networks, plain)
    policy = policies.load_actor(tmp_path / "w.safetensors")
    assert isinstance(policy, TensorDictSequential)
    assert [type(each) for each in policy.module] == [GoalPredictor, GraspActor]
    seen = TensorDict({"image": torch.rand(2, 4, 32, 32), "time_left": torch.ones(2, 1)}, [2])
    by_hand = networks["actor"](networks["goal_network"](seen.clone()))
    assert torch.equal(policy(seen)["action"], by_hand["action"])
    assert set(load_acting(tmp_path / "w.safetensors")) == {"actor", "goal_network"}


def test_demonstrations_of_a_goal_conditioned_learner_keep_the_labels(composed, tmp_path):
    """Its goal network writes predictions under the labels' key; the expert's goals are what is recorded."""
    cfg = composed("experiment=smoke", *CONDITIONED)
    networks = {name: instantiate(cfg.model[name]) for name in ("actor", "goal_network")}
    path = tmp_path / "w.safetensors"
    save_weights(path, networks, OmegaConf.to_container(cfg, resolve=True))
    learner = composed(
        "experiment=smoke", "demonstrations.kind=learner", f"demonstrations.policy={path}", *CONDITIONED
    )
    policy = collect.make_collector(learner)
    td = common.make_env(learner, "train").reset()
    told = common.make_expert(learner, "train", execute=False)(td.clone())
    acted = policy(td.clone())
    torch.testing.assert_close(acted["goal"], told["goal"])
    predicted = networks["goal_network"](td.clone())["goal"]
    expected = networks["actor"](td.clone().set("goal", predicted))["action"]
    torch.testing.assert_close(acted["action"], expected)


def test_a_switch_that_is_none_is_refused(composed):
    with pytest.raises(ConfigError, match=r"model.actor.goal_input=maybe"):
        td3_bc.train(composed("experiment=smoke", "model.actor.goal_input=maybe"))


def test_what_does_not_go_together_is_refused(composed):
    cfg = composed("experiment=smoke", "model=resnet18", "model.width=0.25")
    with pytest.raises(ConfigError, match=r"read \['image'\].*replay=images"):
        Learner(cfg, {"points": (38, 4), "time_left": (1,), "table_plane": (4,), "wrist_angle": (1,)})
    cfg = composed("experiment=smoke", "model.width=0.25", "~transforms.points")
    with pytest.raises(ConfigError, match=r"write no \['points'\]"):
        Learner(cfg, {"time_left": (1,), "table_plane": (4,), "wrist_angle": (1,)})
    images = ["model=resnet18", "model.width=0.25", "transforms=rgbd", "replay=images"]
    with pytest.raises(ConfigError, match=r"RandomMirror.*replay\.augment"):
        Learner(
            composed("experiment=laptop", *images),
            {"image": (4, 32, 32), "time_left": (1,), "table_plane": (4,), "wrist_angle": (1,)},
        )
