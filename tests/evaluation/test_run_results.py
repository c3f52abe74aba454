"""Finished runs that were damaged, or never were any."""

import json

import pytest
import yaml

from tests.hostile_values import YAML_BOMB, check_each, check_texts
from tests.run_files import success_table, write_run
from torchgrasp.errors import CheckpointError, TorchgraspError
from torchgrasp.evaluation.run_results import read_result

PREDICTION = {"goal_network": {"trajectories": 3, "on_path": {"translation_m": {"min": 0.1, "mean": 0.2}}}}


@pytest.fixture
def run(tmp_path):
    tables = {"policy": success_table(3), "expert": success_table(9)}
    return write_run(tmp_path / "run", 0, 3, comparison=tables, grasp_prediction=PREDICTION)


def free(words):
    """Tables that are not asked for, what a success table tells besides, and what older files lack."""
    place, _, kind = words.partition(": ")
    parts = place.split(".")
    told = {"failures", "never_lifted", "comparison", "grasp_prediction", "hardware", "versions"}
    rest = {"success_rate", "success_ci95"} & set(parts[1:])
    lacking = kind == "left out" and ("objects" in parts or parts == ["outcomes"])
    return bool(told & set(parts) or rest) or kind == "more" or lacking


@pytest.mark.parametrize("key", [None, "expert", "grasp_prediction"])
def test_a_hostile_summary_is_refused_or_makes_no_difference(run, key):
    file = run / "summary.json"
    summary = json.loads(file.read_text())

    def write(document):
        file.write_text(json.dumps(document))

    assert check_each(summary, write, lambda: read_result(run, key=key), free=free) > 500
    check_texts(file, lambda: read_result(run))


def test_a_hostile_configuration_is_refused_or_only_of_other_scenes(run):
    file = run / "config.yaml"
    config = yaml.safe_load(file.read_text())

    def write(document):
        file.write_text(yaml.safe_dump(document, default_flow_style=True))

    def free(words):
        return words.count(".") or words.endswith((": left out", ": more", "seed: null", ": mapping"))

    assert check_each(config, write, lambda: read_result(run), free=free) > 100


@pytest.mark.parametrize("policy", [None, "a" * 5000, "a\0b", [1], {"x": 1}, "/dev/zero", 10**30])
def test_a_policy_that_is_no_run_has_no_seed(run, policy):
    config = yaml.safe_load((run / "config.yaml").read_text())
    (run / "config.yaml").write_text(yaml.safe_dump({**config, "policy": policy}))
    try:
        assert read_result(run).seed is None
    except TorchgraspError as error:
        assert "config.yaml" in str(error)


def test_a_number_that_no_float_holds_is_told(run):
    summary = json.loads((run / "summary.json").read_text())
    summary["grasp_prediction"]["goal_network"]["on_path"]["translation_m"]["min"] = 10**400
    (run / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(TorchgraspError, match="holds no number"):
        read_result(run, key="grasp_prediction")


def test_a_bomb_of_references_is_refused(run):
    (run / "config.yaml").write_text(YAML_BOMB)
    with pytest.raises(CheckpointError, match=r"config\.yaml cannot be used"):
        read_result(run)
