"""A run's directory and configuration, made and taken up again."""

import json
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.configurations import change_run
from torchgrasp.config import open_run_dir, training_config
from torchgrasp.data.files import seal_text
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import save_checkpoint


def test_a_new_run_keeps_its_configuration_for_readers_and_for_changes(composed, tmp_path):
    cfg = training_config(composed("experiment=smoke", "seed=4"), "td3_bc")
    run_dir = open_run_dir(cfg, "td3_bc")
    assert run_dir.parent == tmp_path / "td3_bc"
    assert OmegaConf.load(run_dir / "config.yaml").replay.codec.state_keys[0] == "time_left"
    assert "${" not in (run_dir / "config.yaml").read_text()
    assert "${seed}" in (run_dir / ".config_unresolved.yaml").read_text()


def test_a_resumed_run_has_its_configuration_changed_by_what_was_given(on_command_line, composed):
    run_dir = open_run_dir(composed("experiment=smoke", "seed=4"), "td3_bc")
    given = on_command_line(f"resume={run_dir}", "total_env_steps=99", "online.updates=7")
    cfg = training_config(given, "td3_bc")
    assert (cfg.seed, cfg.total_env_steps, cfg.online.updates, cfg.num_points) == (4, 99, 7, 32)
    assert cfg.collector.noise.annealing_steps == 99  # what refers to a change follows it
    assert open_run_dir(cfg, "td3_bc") == run_dir
    with pytest.raises(ConfigError, match="does not go with experiment=paper"):
        training_config(on_command_line(f"resume={run_dir}", "experiment=paper"), "td3_bc")


def test_folders_may_have_numbers_for_names(composed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_dir = open_run_dir(composed("experiment=smoke", "output_dir=2026"), "td3_bc")
    assert run_dir.parent.parent == Path("2026")
    run_dir.rename("1.5")
    assert training_config(composed("resume=1.5"), "td3_bc").resume == "1.5"
    training_config(composed("experiment=smoke", "demonstrations.path=7"), "td3_bc")


def test_experiments_and_runs_of_another_recipe_are_refused(composed, tmp_path):
    with pytest.raises(ConfigError, match="is for the recipe bc: run it by that, not by td3_bc"):
        training_config(composed("experiment=[smoke,table1/dagger]"), "td3_bc")
    with pytest.raises(ConfigError, match="is for the recipe None"):
        training_config(composed("experiment=smoke", "~recipe"), "td3_bc")
    run_dir = open_run_dir(composed("experiment=smoke", recipe="bc"), "bc")
    with pytest.raises(CheckpointError, match="is no run directory of td3_bc"):
        training_config(composed(f"resume={run_dir}"), "td3_bc")
    with pytest.raises(CheckpointError, match=r"^resume=no/such/run is no run directory of td3_bc"):
        training_config(composed("resume=no/such/run"), "td3_bc")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "was changed or cut short"),
        (seal_text("{"), "cannot be used .*restore it from a copy"),
        (seal_text("a: &a [1]\nb: *a"), "it refers to its own parts"),
        (seal_text("[1, 2]"), "is of another kind"),
        (seal_text("recipe: td3_bc\nseed: ${nothing}"), "cannot be used"),
        (seal_text("recipe: td3_bc\nseed: ${oc.env:HOME}"), "seed=.* is more than a reference to a value"),
    ],
)
def test_a_damaged_configuration_is_named(composed, text, told):
    run_dir = open_run_dir(composed("experiment=smoke"), "td3_bc")
    (run_dir / ".config_unresolved.yaml").write_text(text)
    with pytest.raises((CheckpointError, ConfigError), match=told):
        training_config(composed(f"resume={run_dir}"), "td3_bc")


@pytest.mark.parametrize("place", ["camera", "collector.pool", "objects", "loss"])
def test_a_strangers_run_directory_names_no_code(composed, tmp_path, place):
    run_dir = open_run_dir(composed("experiment=smoke"), "td3_bc")
    touched = tmp_path / "touched"
    change_run(run_dir, **{place: {"_target_": "torchgrasp.runs.weights.Path.touch", "self": str(touched)}})
    told = rf"could run anything: {place} names torchgrasp\.runs\.weights\.Path\.touch"
    with pytest.raises(ConfigError, match=told):
        training_config(composed(f"resume={run_dir}"), "td3_bc")
    assert not touched.exists()


def test_a_run_with_classes_of_ones_own_is_resumed_with_trust(composed, tmp_path, monkeypatch):
    (tmp_path / "own_parts.py").write_text(
        "from torchgrasp.transforms import SamplePoints\nclass Mine(SamplePoints): pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    own = "transforms.sample._target_=own_parts.Mine"
    run_dir = open_run_dir(training_config(composed("experiment=smoke", own), "td3_bc"), "td3_bc")
    with pytest.raises(ConfigError, match=r"trust=\[own_parts\]"):
        training_config(composed(f"resume={run_dir}"), "td3_bc")
    cfg = training_config(composed(f"resume={run_dir}", "trust=[own_parts]"), "td3_bc")
    assert cfg.transforms.sample._target_ == "own_parts.Mine"


def test_a_checkpoint_of_another_version_is_refused_with_two_ways_on(composed):
    run_dir = open_run_dir(composed("experiment=smoke"), "td3_bc")
    save_checkpoint(run_dir / "checkpoint", {"progress": {"iteration": 1}})
    training_config(composed(f"resume={run_dir}"), "td3_bc")
    file = run_dir / "checkpoint" / "manifest.json"
    assert json.loads(file.read_text())["format"] == 3
    file.write_text(json.dumps({**json.loads(file.read_text()), "format": 1}))
    told = r"has format 1, this version reads 3: go on with the torchgrasp that wrote it, or .*init="
    with pytest.raises(CheckpointError, match=told):
        training_config(composed(f"resume={run_dir}"), "td3_bc")
