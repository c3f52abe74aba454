"""Cells of the paper's tables: each composes with every scale, builds, and is what its name says."""

import functools
import re

import pytest
from omegaconf import DictConfig, OmegaConf

from tests.configurations import ROOT, compose_config
from torchgrasp.config import make_actor_critic, make_imitation_learner
from torchgrasp.config.demonstration_sources import list_demonstrations
from torchgrasp.config.environments import make_objects
from torchgrasp.config.main_phase import MainPhase
from torchgrasp.config.training_checks import check_training
from torchgrasp.config.transition_storage import make_experience

FOLDER = ROOT / "conf" / "experiment"
CELLS = sorted(
    str(path.relative_to(FOLDER).with_suffix(""))
    for path in FOLDER.glob("*/*.yaml")
    if path.parent.name != "parts"
)
# The slow ones say the same at other sizes.
SLOW = (pytest.param(each, marks=pytest.mark.slow) for each in ("minutes", "smoke"))
SCALES = ["laptop", "paper", *SLOW]
_AUX = ("model.actor.goal_prediction", "model.critic.goal_prediction")
_READ = ("model.actor.goal_input", "model.critic.goal_input")
_TABLE_5 = {"offline.updates": "auto", "evaluation.grasp_prediction": True}
_IMAGES = {"camera._target_": "torchgrasp.sim.RenderCamera", "replay.codec.points_key": None}
# What the name of each cell promises at every scale.
PROMISED = {
    "table1/offline": {"offline.updates": "auto", _AUX[0]: False},
    "table1/online": {"offline.updates": 0, "online.rollouts": ["expert"], _AUX[0]: False},
    "table1/dagger": {"online.rollouts": ["expert", "learner"], _AUX[0]: False},
    "table1/dagger_aux": {"online.rollouts": ["expert", "learner"], _AUX[0]: True},
    "table1/rgb": {**_IMAGES, "transforms.image.channels": "rgb", "model.channels": 3, _AUX[0]: True},
    "table1/rgbd": {**_IMAGES, "transforms.image.channels": "rgbd", "model.channels": 4, _AUX[0]: True},
    "table1/rgbdm": {**_IMAGES, "transforms.image.channels": "rgbdm", "model.channels": 5, _AUX[0]: True},
    "table2/aux_neither": {_AUX[0]: False, _AUX[1]: False},
    "table2/aux_critic": {_AUX[0]: False, _AUX[1]: True},
    "table2/aux_actor": {_AUX[0]: True, _AUX[1]: False},
    "table2/aux_both": {_AUX[0]: True, _AUX[1]: True, _READ[0]: False, _READ[1]: False},
    "table2/goal_conditioned": {_AUX[0]: False, _AUX[1]: False, _READ[0]: True, _READ[1]: True},
    "table3/no_bc": {"loss.bc_weight": 0.0, "pretrain.steps": 0},
    "table3/offline": {"offline.updates": "auto", "demonstrations.more.failed.kind": "failed"},
    "table3/no_dagger": {"online.dagger": False},
    "table3/image": {**_IMAGES, "transforms.image.channels": "rgbdm", "model.channels": 5},
    "table3/no_aggregation": {"transforms.aggregate": None},
    "table3/late_fusion": {"model.critic.fusion": "late"},
    "table3/no_expert_start": {"collector.expert_start.probability": 0.0},
    "table3/l2": {"loss.distance.norm": "l2", "loss.goal_distance.norm": "l2"},
    "table5/goal_auxiliary": {**_TABLE_5, _AUX[0]: True},
    "table5/goal_conditioned": {**_TABLE_5, _READ[0]: True},
    "hindsight/normal": {"loss.hindsight": True, "env.physics.friction": 1.0, "objects.split": "test"},
    "hindsight/low_friction": {"loss.hindsight": True, "env.physics.friction": 0.3, "objects.split": "test"},
    "moving/hindsight": {"env.target_motion": "static", "evaluation.target_motion": "jitter"},
    "moving/td3_bc": {"env.target_motion": "static", "evaluation.target_motion": "jitter"},
}


def read_recipe(cell: str) -> str:
    return OmegaConf.load(FOLDER / f"{cell}.yaml").recipe


@pytest.fixture
def compose_cell(composed):
    def compose(cell: str, scale: str, *overrides: str):
        return composed(f"experiment=[{scale},{cell}]", *overrides, recipe=read_recipe(cell))

    return compose


@functools.cache
def compose_plain(scale: str) -> DictConfig:
    return compose_config(f"experiment=[{scale},table2/aux_both]")


def test_every_cell_is_promised_something():
    assert list(PROMISED) and set(PROMISED) == set(CELLS)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("cell", CELLS)
def test_a_cell_composes_with_every_scale_and_builds(compose_cell, cell, scale):
    cfg = compose_cell(cell, scale, "model.width=0.25")
    check_training(cfg)
    for name, promised in PROMISED[cell].items():
        assert OmegaConf.select(cfg, name) == promised, name
    plain = compose_plain(scale)
    assert cfg.total_env_steps == plain.total_env_steps and cfg.online.updates == plain.online.updates
    assert cfg.demonstrations.steps == plain.demonstrations.steps
    # Encoders of a run that is begun with may be frozen; there is none here.
    OmegaConf.update(cfg, "model.actor.freeze_encoder", False)
    OmegaConf.update(cfg, "model.critic.freeze_encoder", False)
    cfg.replay.online_capacity = 100
    channels = cfg.model.get("channels", 4)
    shapes = {
        "points": (cfg.num_points + 6, 4),
        "image": (channels, 32, 32),
        "time_left": (1,),
        "table_plane": (4,),
        "wrist_angle": (1,),
    }
    learner = (make_imitation_learner if cfg.recipe == "bc" else make_actor_critic)(cfg)
    make_experience(cfg, learner.networks, shapes, own="online")
    assert ("critic" in learner.networks) is (cfg.recipe != "bc")
    assert ("goal_network" in learner.networks) is cfg.model.actor.goal_input


@pytest.mark.parametrize("cell", CELLS)
def test_training_sees_no_object_of_the_evaluation(compose_cell, cell):
    cfg = compose_cell(cell, "laptop")
    trained, tested = (set(make_objects(cfg, split).names) for split in ("train", "test"))
    if cfg.recipe != "hindsight":
        assert trained and tested and not trained & tested
        return
    # The method itself: unknown objects are practised on. Their scenes are others.
    assert trained == tested and len(trained) == 9
    assert cfg.seed != cfg.evaluation.seed


def test_offline_cells_update_as_often_as_online_ones(compose_cell):
    """33,600 steps of 30, 14 episodes an iteration: 80 times 40 updates; 120,000 failures beside 50,000."""
    laptop, paper = (compose_cell("table3/offline", scale) for scale in ("laptop", "paper"))
    assert MainPhase.of(laptop).length == 3200 and MainPhase.of(paper).length == 7143 * 20
    asked = {name: each.demonstrations.steps for name, each in list_demonstrations(paper).items()}
    assert asked == {"expert": 50000, "failed": 120000}


@pytest.mark.checkout
def test_the_page_of_experiments_lists_each_cell_with_its_published_number():
    page = (ROOT / "docs" / "experiments.md").read_text()
    rows = {m[1]: line for line in page.splitlines() if (m := re.search(r"\[laptop,([\w/]+)\]", line))}
    assert set(rows) == set(CELLS)
    for cell, row in rows.items():
        assert f"recipes/{read_recipe(cell)}.py" in row
        published = re.search(r"# Published: (.*)", (FOLDER / f"{cell}.yaml").read_text())
        numbers = re.findall(r"\d+\.\d+", published[1]) if published else []
        assert numbers == re.findall(r"\d+\.\d+", row.split("|")[3]), cell
