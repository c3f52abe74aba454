"""policy=planning, combined and takeover of recipes/evaluate.py."""

import json

import policies
import pytest
import reports
import settings
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict import TensorDict

from torchgrasp.config.one_line_errors import find_cause
from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.planning import ExpertPolicy, OpenLoopPolicy, Relay
from torchgrasp.rollouts.episode_pool import Episode
from torchgrasp.runs.weights import save_weights

SMALL = ["objects.num_objects=4", "evaluation.num_objects=4", "objects.num_grasps=100"]
SMALL += ["evaluation.num_envs=2", "collector.num_workers=0"]


@pytest.fixture
def learner(composed, tmp_path):
    """The weights file of an untrained policy, with the configuration that it brings along."""
    cfg = composed("experiment=smoke", "env.horizon=28", "transforms.sample.num_points=48")
    networks = {"actor": instantiate(cfg.model.actor), "critic": instantiate(cfg.model.critic)}
    path = tmp_path / "trained" / "weights.safetensors"
    save_weights(path, networks, OmegaConf.to_container(cfg, resolve=True))
    return path


def configured(composed, *overrides: str):
    return settings.for_evaluation(composed(*overrides, *SMALL, recipe="evaluate"))


def test_planning_is_configured_by_its_group(composed):
    made = {}
    for planning in ("perfect", "noisy"):
        cfg = configured(composed, "policy=planning", f"planning={planning}", "planning.steps=22")
        made[planning] = policies.make_policy(cfg, "planning")
        assert isinstance(made[planning], OpenLoopPolicy) and made[planning].steps == 22
    assert made["perfect"].pose_noise is None
    noise = made["noisy"].pose_noise
    assert noise.translation == 0.01 and noise.rotation == pytest.approx(5 * torch.pi / 180, rel=1e-3)


def test_a_learner_brings_its_horizon_and_transforms_into_a_relay(composed, learner):
    for policy, steps in (("combined", (20, 20)), ("takeover", (0, 25))):
        cfg = configured(composed, f"policy={policy}", f"learner={learner}")
        assert cfg.env.horizon == 28 and cfg.transforms.sample.num_points == 48
        relay = policies.make_policy(cfg, policy)
        assert isinstance(relay, Relay) and (relay.low, relay.high) == steps
        planned, learned = (relay.first, relay.second)[:: 1 if policy == "combined" else -1]
        assert isinstance(planned, OpenLoopPolicy if policy == "combined" else ExpertPolicy)
        assert planned.horizon == 28 and learned.state_dict()


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["policy=nobody"], "expert, random, planning, combined, takeover"),
        (["policy=combined"], "needs a learner"),
        (["policy=takeover"], "needs a learner"),
        (["policy=combined", "learner=no/such/run"], "learner='no/such/run'"),
        (["policy=takeover", "learner=expert"], "learner='expert'"),
        (["policy=expert", "learner=random"], "combined or takeover"),
        (["policy=planning", "planning.steps=31"], "planning.steps=31"),
        (["policy=planning", "env.horizon=20"], "20 steps"),
        (["policy=planning", "planning.steps=0"], "planning.steps=0"),
        (["policy=planning", "planning=noisy", "planning.pose_noise.translation=-1"], "translation=-1"),
        (["policy=combined", "learner=random", "combined.steps=31"], "31"),
        (["policy=takeover", "learner=random", "takeover.steps=[5,40]"], "40"),
    ],
)
def test_what_cannot_be_is_refused_by_name(composed, overrides, told):
    with pytest.raises((TorchgraspError, InstantiationException)) as raised:
        cfg = configured(composed, *overrides)
        policies.make_policy(cfg, str(cfg.policy))
    cause = find_cause(raised.value)
    assert isinstance(cause, ConfigError) and told in str(cause)


def test_points_are_the_policys_own(run_recipe, learner):
    code, _, err = run_recipe("evaluate", f"policy={learner}", "episodes=1", "num_points=12", *SMALL)
    assert code == 1 and "num_points along, does not go with num_points=12" in err


def summary_of(tmp_path) -> dict:
    (file,) = tmp_path.glob("evaluate/*/summary.json")
    return json.loads(file.read_text())


def test_takeover_reports_by_the_learners_steps(run_recipe, tmp_path, learner):
    options = ["policy=takeover", f"learner={learner}", "episodes=5", *SMALL]
    code, out, err = run_recipe("evaluate", *options)
    assert code == 0, err
    summary = summary_of(tmp_path)
    bins = summary["learner_steps"]
    assert set(bins) <= {"0-5", "6-10", "11-15", "16-20", "21-25"}
    assert sum(row["episodes"] for row in bins.values()) == 5
    assert all(name in out for name in bins)
    assert summary["learner"] == str(learner)


def test_planning_and_combined_work_in_other_protocols(run_recipe, tmp_path, learner):
    options = ["policy=combined", f"learner={learner}", "protocol=handover", "planning=noisy", "episodes=3"]
    code, out, err = run_recipe("evaluate", *options, *SMALL)
    assert code == 0, err
    summary = summary_of(tmp_path)
    failed = {name for name, row in summary["objects"].items() if row["successes"] < row["episodes"]}
    assert all(name in out for name in failed)
    assert sum(sum(row["failures"].values()) for row in summary["objects"].values()) == sum(
        summary["failures"].values()
    )


@pytest.mark.parametrize(
    ("steps", "name"), [(0, "0-5"), (5, "0-5"), (6, "6-10"), (10, "6-10"), (11, "11-15"), (25, "21-25")]
)
def test_learner_steps_are_counted_in_fives(steps, name):
    turn = (torch.arange(30) >= steps).long()[:, None]
    assert reports.learner_steps(Episode(TensorDict({"turn": turn}, [30]), "mug", 0, 0)) == name


def test_the_worst_objects_come_first_and_those_without_failure_never():
    table = SuccessTable()
    for name, outcomes in {"good": [1] * 5, "once": [0], "often": [0] * 5, "half": [1, 0, 1, 0]}.items():
        for success in outcomes:
            table.add(name, bool(success))
    assert list(reports.worst_objects(table.rows())) == ["often", "once", "half"]
    assert list(reports.worst_objects(table.rows(), at_most=1)) == ["often"]
