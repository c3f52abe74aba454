"""A residual in td3_bc.py and hindsight.py: imitation, then a bounded correction, learned of tries."""

import json
import shutil
from pathlib import Path

import pytest
import torch

import torchgrasp
from recipes import evaluate, hindsight, td3_bc
from tests.configurations import compose_config
from tests.recipes.runner import find_run, read_metrics, read_results, stored_rows
from tests.recipes.test_td3_bc import kill_and_resume
from torchgrasp.config.networks import load_networks, make_networks
from torchgrasp.config.weights_files import read_trained
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.runs import load_weights, save_weights
from torchgrasp.transforms import RandomMirror

GIVEN = ["experiment=[smoke,residual]", "online.critic_warmup=1", "evaluation.baselines=[]"]
GIVEN += ["collector.tries.num_tries=3", "env.horizon=8", "total_env_steps=48"]


@pytest.fixture(scope="module")
def corrected(tmp_path_factory) -> Path:
    """The run directory of imitation and a residual."""
    root = tmp_path_factory.mktemp("corrected")
    td3_bc.train(compose_config(f"output_dir={root}", *GIVEN))
    return find_run(root, "td3_bc")


def test_imitation_is_corrected_and_stays_the_base(corrected):
    states, config = load_weights(corrected / "weights.safetensors")
    assert config["model"]["residual"] == {"scale": 0.4, "hidden": 256, "last_steps": 1, "horizon": 8}
    corrections = [value for key, value in states["actor"].items() if "correction" in key]
    assert corrections and not all(value.eq(0).all() for value in corrections[-2:])
    summary = json.loads((corrected / "summary.json").read_text())
    assert set(summary["comparison"]) == {"policy", "policy after imitation alone"}
    assert "added by reinforcement" in summary["gains"]


def test_what_was_tried_is_in_the_buffer_and_the_features_are_kept(corrected):
    rows = stored_rows(corrected, "online")
    assert rows["features.actor"].shape[1:] == (64,) and "points" not in rows
    # Of each episode three tries of its last step, which end with it.
    last = rows["time_left"].flatten() < 0.126
    assert last.sum() == 4 * (~last).sum() / 7
    assert rows["terminated"].flatten()[last].all() and not rows["has_expert"].any()


def test_a_trained_residual_acts_alone(corrected, tmp_path):
    policy = torchgrasp.load_policy(corrected)
    env = torchgrasp.make_env(policy, num_envs=1)
    assert env.rollout(2, policy)["base_action"].shape == (1, 2, 6)
    given = [f"policy={corrected}", "value_quality=0.99", "objects.num_objects=4", "episodes=4"]
    given += ["evaluation.num_envs=2", "collector.num_workers=0", f"output_dir={tmp_path}"]
    summary = evaluate.evaluate(compose_config(*given, recipe="evaluate"))
    assert summary["episodes"] == 4 and summary["value_quality"]


@pytest.mark.parametrize("kill_at", [0, 7])
def test_killed_before_or_after_the_change_of_learners_it_ends_alike(corrected, tmp_path, kill_at):
    run_dir = kill_and_resume(tmp_path, kill_at, *GIVEN)
    assert read_results(run_dir) == read_results(corrected)
    ours, theirs = (load_weights(each / "weights.safetensors")[0] for each in (run_dir, corrected))
    for name in ("actor", "critic"):
        assert all(torch.equal(value, theirs[name][key]) for key, value in ours[name].items())


def test_a_trained_policy_is_corrected_from_the_first_step(composed, tmp_path, trained):
    """Nobody demonstrates then; the encoder stays, and the policy is also measured as it was."""
    given = [f"init={trained[0]}", "pretrain.steps=0", *GIVEN]
    summary = td3_bc.train(composed(*given))
    assert "policy before reinforcement" in summary["comparison"] and "demonstrations" not in summary
    before, after = (
        load_weights(each / "weights.safetensors")[0]["actor"]
        for each in (trained[0], find_run(tmp_path, "td3_bc"))
    )
    encoder = {key: value for key, value in before.items() if ".encoder." in key}
    kept = [value for key, value in after.items() if ".encoder." in key]
    assert encoder and all(map(torch.equal, encoder.values(), kept))


def test_without_a_residual_training_begins_with_what_was_corrected(composed, corrected, capsys):
    networks = make_networks(composed("experiment=smoke").model)
    assert load_networks(networks, read_trained(corrected)) == ["actor"]
    told = capsys.readouterr().out
    assert "has been corrected" in told and "the critic begins anew" in told
    policy = torchgrasp.load_policy(corrected)
    state = torchgrasp.make_env(policy, num_envs=1, objects=ProceduralObjects("val", num_objects=1)).reset()
    assert torch.equal(networks["actor"](state.copy())["action"], policy(state.copy())["base_action"])


def test_a_correction_without_its_actor_is_told_in_one_line(composed, corrected, tmp_path):
    states, config = load_weights(corrected / "weights.safetensors")
    save_weights(tmp_path / "critic.safetensors", {"critic": states["critic"]}, config)
    networks = make_networks(composed("experiment=smoke").model, critic=False)
    with pytest.raises(CheckpointError, match="holds weights of other networks"):
        load_networks(networks, read_trained(tmp_path / "critic.safetensors"))


def test_fine_tuning_of_a_weights_file_needs_no_demonstrations(composed, tmp_path, trained):
    file = shutil.copy(trained[0] / "weights.safetensors", tmp_path / "alone.safetensors")
    given = ["experiment=[smoke,residual,hindsight/normal]", "objects=procedural", f"init={file}"]
    hindsight.train(composed(*given, "total_env_steps=16", recipe="hindsight"))
    assert not (find_run(tmp_path, "hindsight") / "demonstrations").exists()


def test_fine_tuning_begins_with_weights_that_tell_no_more_than_they_must(composed, tmp_path, trained):
    """What load_policy takes: neither storage, demonstrations, action space nor a critic are told."""
    states, config = load_weights(trained[0] / "weights.safetensors")
    told = {name: config[name] for name in ("camera", "transforms", "model", "num_points")}
    told["model"] = {name: each for name, each in told["model"].items() if name != "critic"}
    del states["critic"]
    file = tmp_path / "bare.safetensors"
    save_weights(file, states, {**told, "env": {"_target_": "torchgrasp.envs.GraspEnv", "horizon": 8}})
    given = ["experiment=[smoke,residual]", "objects=procedural", f"init={file}", "total_env_steps=16"]
    summary = hindsight.train(composed(*given, "collector.tries.num_tries=3", recipe="hindsight"))
    assert summary["env_steps"] >= 16


@pytest.mark.parametrize("begun_with_residual", [False, True])
def test_fine_tuning_corrects_what_it_begins_with(
    composed, tmp_path, trained, corrected, begun_with_residual
):
    """A policy without a residual gets one; one that has one goes on with it, and with its critic."""
    init = corrected if begun_with_residual else trained[0]
    given = ["experiment=[smoke,residual,hindsight/normal]", "objects=procedural", "total_env_steps=32"]
    given += [f"init={init}", "collector.tries.num_tries=3", "model.residual.scale=0.1"]
    given = given[:-1] if begun_with_residual else given
    summary = hindsight.train(composed(*given, recipe="hindsight"))
    assert summary["env_steps"] >= 32
    _, config = load_weights(find_run(tmp_path, "hindsight") / "weights.safetensors")
    assert config["model"]["residual"]["scale"] == (0.4 if begun_with_residual else 0.1)
    assert read_metrics(find_run(tmp_path, "hindsight"))[-2]["critic/loss_qvalue"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["pretrain.steps=0"], "model.residual corrects a trained actor, and there is none"),
        (["pretrain.critic=true"], "pretrain.critic=true with model.residual"),
        (["model.actor.goal_input=true"], "model.actor.goal_input=true with model.residual"),
        (["model.critic.goal_input=true"], "model.critic.goal_input=true with model.residual"),
        (["loss.bc_weight=0.5"], "loss.bc_weight=0.5, but the policy learns of its own episodes"),
        (["replay.keep_features=null"], "replay.keep_features=None with model.residual"),
        (["model.critic.norm=bogus"], "norm='bogus' is unknown"),
        (["model.residual.last_steps=9"], "model.residual.last_steps=9"),
        (["model.residual.horizon=9"], "model.residual.horizon=9 with env.horizon=8"),
        (["collector.tries.horizon=9"], "collector.tries.horizon=9 with env.horizon=8"),
        (["model.residual.scale=2"], "model.residual.scale=2"),
        (["+model.residual.size=3"], "model.residual.size"),
        (["collector.tries.num_tries=0"], "collector.tries.num_tries=0"),
    ],
)
def test_what_does_not_go_with_a_residual_is_refused(composed, tmp_path, given, message):
    """Before anything is collected."""
    with pytest.raises(ConfigError, match=message):
        td3_bc.train(composed(*GIVEN, *given))
    assert not list(tmp_path.glob("td3_bc/*/demonstrations"))


def test_a_corrected_policy_is_not_imitated_anew(composed, corrected):
    with pytest.raises(ConfigError, match=r"has been corrected by reinforcement.* pretrain\.steps=0"):
        td3_bc.train(composed(*GIVEN, f"init={corrected}"))


def test_mirrored_states_are_corrected_too_and_the_buffer_may_lie_on_disk(composed, tmp_path):
    """Laptop's augmentation, of which features of both views are kept; the files of imitation are gone."""
    mirrored = "replay.augment={_target_: torchgrasp.transforms.RandomMirror}"
    summary = td3_bc.train(composed(*GIVEN, mirrored, f"replay.folder={tmp_path / 'rows'}"))
    assert summary["env_steps"] >= 48
    rows = stored_rows(find_run(tmp_path, "td3_bc"), "online")
    assert rows["features.actor"].shape[1:] == (len(RandomMirror().views), 64)
    assert not (tmp_path / "rows" / "imitation").exists()


def test_grasps_are_predicted_by_the_critic_of_a_residual(composed):
    given = ["model.critic.goal_prediction=true", "evaluation.grasp_prediction=true"]
    summary = td3_bc.train(composed(*GIVEN, *given))
    assert set(summary["grasp_prediction"]) == {"actor", "critic"}


def test_without_a_main_phase_imitation_alone_is_saved_and_another_run_begins_with_it(composed, tmp_path):
    td3_bc.train(composed(*GIVEN, "total_env_steps=0"))
    run_dir = find_run(tmp_path, "td3_bc")
    states, config = load_weights(run_dir / "weights.safetensors")
    assert set(states) == {"actor"} and config["model"]["residual"] is None
    begun = [f"init={run_dir}", "pretrain.steps=0", f"output_dir={tmp_path / 'begun'}"]
    td3_bc.train(composed(*GIVEN, *begun, "total_env_steps=16"))


def test_demonstrations_alone_teach_a_residual_offline(composed):
    summary = td3_bc.train(composed(*GIVEN, "offline.updates=4"))
    assert summary["gradient_steps"] == 6 + 4
