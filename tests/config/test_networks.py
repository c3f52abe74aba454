"""Networks of a configuration, and what trained ones may begin."""

import pytest
import torch
from omegaconf import OmegaConf

from torchgrasp.config.networks import begin_networks, check_state_inputs, make_networks, rebuild_acting
from torchgrasp.config.weights_files import read_trained
from torchgrasp.errors import CheckpointError, ConfigError
from torchgrasp.runs import load_weights, save_weights

CONDITIONED = ["model.actor.goal_input=true", "model.critic.goal_input=true"]
FROZEN = ["model.actor.freeze_encoder=true", "model.critic.freeze_encoder=true"]


def equal(networks, path):
    """Which of the networks have the weights of a file."""
    states = load_weights(path)[0]
    return {
        name: all(torch.equal(value, states[name][key]) for key, value in network.state_dict().items())
        for name, network in networks.items()
    }


def test_networks_begin_with_those_that_init_names(composed, untrained):
    path = untrained()
    cfg = composed("experiment=smoke", f"init={path.parent}", *FROZEN)
    networks = make_networks(cfg.model)
    assert equal(networks, path) == {"actor": False, "critic": False}
    begin_networks(cfg, networks)
    assert equal(networks, path) == {"actor": True, "critic": True}


def test_a_critic_that_imitation_has_not_trained_begins_anew_and_is_not_frozen(composed, untrained, capsys):
    path = untrained(recipe="bc")
    cfg = composed("experiment=smoke", f"init={path}")
    networks = make_networks(cfg.model)
    begin_networks(cfg, networks)
    assert "the critic begins anew" in capsys.readouterr().out
    assert equal({"actor": networks["actor"]}, path) == {"actor": True}
    cfg = composed("experiment=smoke", f"init={path}", *FROZEN)
    with pytest.raises(ConfigError, match=r"model\.critic\.freeze_encoder=true would keep random weights"):
        begin_networks(cfg, make_networks(cfg.model))


def test_random_encoders_are_not_frozen(composed):
    cfg = composed("experiment=smoke", *FROZEN)
    with pytest.raises(ConfigError, match=r"freeze_encoder=true would keep random weights.*init="):
        begin_networks(cfg, make_networks(cfg.model))


def test_weights_of_other_networks_are_refused(composed, untrained):
    cfg = composed("experiment=smoke", f"init={untrained()}", "model.width=0.5")
    with pytest.raises(CheckpointError, match=r"holds weights of other networks .*choose the model"):
        begin_networks(cfg, make_networks(cfg.model))


def test_weights_bring_the_goal_network_and_no_file_of_their_own(composed, tmp_path):
    """Public weights that a run began with need not be there when its policy is loaded."""
    cfg = composed("experiment=smoke", "model=resnet18", "model.width=0.25", *CONDITIONED)
    networks = make_networks(cfg.model)
    config = OmegaConf.to_container(cfg, resolve=True)
    for each in (config["model"], *(config["model"][name] for name in networks)):
        each["encoder"]["weights"] = "/nowhere/resnet18.safetensors"
    save_weights(tmp_path / "w.safetensors", networks, config)
    trained = read_trained(tmp_path / "w.safetensors")
    assert set(rebuild_acting(trained)) == {"actor", "goal_network"}
    assert set(rebuild_acting(trained, critic=True)) == set(networks)


def test_sizes_are_compared_before_networks_of_that_size_are_made(untrained):
    """A width of a million would take terabytes."""
    trained = read_trained(untrained())
    for name in ("actor", "critic"):
        trained.config["model"][name]["encoder"]["width"] = 1e6
    with pytest.raises(CheckpointError, match=r"holds weights of other networks"):
        rebuild_acting(trained)


def test_what_a_network_reads_has_the_size_that_the_environment_gives(composed):
    model = composed("experiment=smoke", "model.state_inputs={joints: 9}").model
    check_state_inputs(model, {"joints": (9,)})
    check_state_inputs(model, {})  # refused elsewhere, with what would write it
    with pytest.raises(ConfigError, match=r"state_inputs: joints=9, but joints has the shape \(7,\)"):
        check_state_inputs(model, {"joints": (7,)})
