"""An evaluation's configuration: its protocol, what its policy brings along, and what was given."""

import re

import pytest

from torchgrasp.config import evaluation_config
from torchgrasp.errors import ConfigError

BROUGHT = ["env.horizon=28", "transforms.sample.num_points=48", "model.width=0.5"]


def test_a_protocol_changes_the_task(composed):
    started = {}
    for protocol in ("static", "moving", "tabletop", "handover"):
        env = evaluation_config(composed("policy=expert", f"protocol={protocol}", recipe="evaluate")).env
        started[protocol] = (env.target_motion, env.start._target_.rsplit(".", 1)[-1])
    assert started == {
        "static": ("static", "StartPoses"),
        "moving": ("jitter", "StartPoses"),
        "tabletop": ("static", "TabletopStart"),
        "handover": ("handover", "StartPoses"),
    }


def test_what_was_given_stands_above_the_protocol(on_command_line):
    given = ["policy=expert", "protocol=moving", "env.target_motion=mixed", "objects.split=val"]
    cfg = evaluation_config(on_command_line(*given, recipe="evaluate"))
    assert cfg.env.target_motion == "mixed" and cfg.evaluation.split == "val"
    with pytest.raises(ConfigError, match="protocol=tabletop has a start of its own"):
        start = "env.start.min_distance=0.3"
        evaluation_config(on_command_line("policy=expert", "protocol=tabletop", start, recipe="evaluate"))
    varied = ["policy=expert", "protocol=tabletop", "start=varied"]
    assert evaluation_config(on_command_line(*varied, recipe="evaluate")).env.start.spread == 0.25


def test_a_policy_brings_networks_camera_transforms_and_horizon(composed, untrained):
    cfg = evaluation_config(composed(f"policy={untrained(*BROUGHT)}", "episodes=7", recipe="evaluate"))
    assert (cfg.env.horizon, cfg.transforms.sample.num_points, cfg.model.width) == (28, 48, 0.5)
    assert cfg.camera.intrinsics.width == 32 and cfg.overhead is None
    assert (cfg.evaluation.episodes, cfg.evaluation.seed) == (7, 1000)


def test_networks_are_as_they_were_trained_and_the_task_may_be_another(on_command_line, untrained):
    policy = f"policy={untrained(*BROUGHT)}"
    cfg = evaluation_config(on_command_line(policy, "env.horizon=20", "seed=3", recipe="evaluate"))
    assert cfg.env.horizon == 20 and cfg.evaluation.seed == 3
    for given in ("num_points=12", "transforms=single_view"):
        with pytest.raises(ConfigError, match=f"num_points along, does not go with {given}: of these give"):
            evaluation_config(on_command_line(policy, given, recipe="evaluate"))
    for given in (
        "+model.width=2",
        "~transforms.table",
        "+transforms.more={_target_: torchgrasp.transforms.TablePlane}",
    ):
        with pytest.raises(ConfigError, match="does not go with " + re.escape(given)):
            evaluation_config(on_command_line(policy, given, recipe="evaluate"))


def test_a_camera_of_ones_own_sees_for_a_trained_policy_and_the_transforms_follow(on_command_line, untrained):
    policy = f"policy={untrained(*BROUGHT)}"
    own = ("camera.intrinsics.width=212", "camera.intrinsics.height=120", "camera.intrinsics.fov=0.742")
    cfg = evaluation_config(on_command_line(policy, *own, recipe="evaluate"))
    seen = cfg.camera.intrinsics
    assert (seen.width, seen.height, seen.fov) == (212, 120, 0.742) and cfg.model.width == 0.5
    assert cfg.transforms.points.intrinsics == cfg.transforms.aggregate.intrinsics == seen
    assert cfg.transforms.sample.num_points == 48
    chosen = evaluation_config(on_command_line(policy, "camera=render", *own, recipe="evaluate")).camera
    assert chosen._target_ == "torchgrasp.sim.RenderCamera" and chosen.intrinsics.fov == 0.742


def test_single_values_of_the_transforms_hold_where_the_policy_has_them(on_command_line, untrained):
    policy = f"policy={untrained(*BROUGHT)}"
    cfg = evaluation_config(on_command_line(policy, "transforms.aggregate.alpha=0.5", recipe="evaluate"))
    assert cfg.transforms.aggregate.alpha == 0.5
    assert cfg.transforms.points.intrinsics == cfg.camera.intrinsics
    cfg = evaluation_config(on_command_line(policy, "transforms.aggregate.carve=null", recipe="evaluate"))
    assert cfg.transforms.aggregate.carve is None
    single = f"policy={untrained(*BROUGHT, 'transforms=single_view', name='single')}"
    told = r"transforms\.aggregate\.alpha=0\.5 finds nothing to change: policy=.* brings points, "
    with pytest.raises(ConfigError, match=told):
        evaluation_config(on_command_line(single, "transforms.aggregate.alpha=0.5", recipe="evaluate"))


def test_a_policy_of_the_overhead_camera_follows_that_one(on_command_line, untrained):
    views = ["overhead=raycast", "+transforms.points.camera=overhead", "transforms.aggregate.carve=null"]
    views += ["transforms.points.intrinsics=${overhead.intrinsics}"]
    policy = f"policy={untrained(*BROUGHT, *views)}"
    cfg = evaluation_config(on_command_line(policy, "camera.intrinsics.fov=0.7", recipe="evaluate"))
    assert cfg.overhead.intrinsics == cfg.transforms.points.intrinsics
    assert cfg.overhead.intrinsics.fov == 1.0 and cfg.transforms.aggregate.intrinsics.fov == 0.7
    given = (policy, "overhead.intrinsics.fov=0.9", "overhead=raycast", "+transforms.table.seed=3")
    cfg = evaluation_config(on_command_line(*given, recipe="evaluate"))
    assert cfg.transforms.points.intrinsics.fov == 0.9 and cfg.transforms.table.seed == 3


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (
            ["policy=nobody"],
            "^policy='nobody' is not there: give expert, random, planning, combined, takeover",
        ),
        (["policy=combined"], "needs a learner"),
        (["policy=takeover"], "needs a learner"),
        (["policy=combined", "learner=no/such/run"], "^learner='no/such/run'"),
        (["policy=takeover", "learner=expert"], "^learner='expert'"),
        (["policy=expert", "learner=random"], "combined or takeover"),
        (["policy=expert", "protocol=upside_down"], "^protocol='upside_down' is unknown: give one of static"),
        (["policy=expert", "episodes=0"], "^episodes=0 is out of range"),
    ],
)
def test_what_cannot_be_is_refused_by_name(composed, overrides, told):
    with pytest.raises(ConfigError, match=told):
        evaluation_config(composed(*overrides, recipe="evaluate"))


def test_a_trained_policy_is_scored_in_the_engine_that_is_given(on_command_line, untrained):
    policy = f"policy={untrained('engine=mujoco')}"
    for given, name in (([], "SapienEngine"), (["engine=mujoco"], "MujocoEngine")):
        cfg = evaluation_config(on_command_line(policy, *given, recipe="evaluate"))
        assert cfg.engine._target_ == f"torchgrasp.sim.{name}"
