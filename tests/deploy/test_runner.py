"""The exported files: the whole way from pictures to poses without torch, beside GraspAgent."""

import itertools
import json
import re
import subprocess
import sys

import numpy as np
import pytest

from tests.deploy.recordings import WIDE, policy, record
from torchgrasp.deploy.policy_files import export_policy
from torchgrasp.deploy.runner import Camera, GraspPolicy, PolicyError, _choose_thin, _smallest_around
from torchgrasp.deploy.sight import choose_thin
from torchgrasp.intrinsics import CameraIntrinsics
from torchgrasp.sim import RaycastCamera
from torchgrasp.sim.kinematics import READY_POSTURE, forward_kinematics

T_EE_CAMERA = RaycastCamera().T_ee_camera


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    export_policy(policy(), output=folder / "policy.onnx")
    return folder


@pytest.fixture(scope="module")
def recording():
    return record(episodes=4, motion="mixed")


@pytest.mark.parametrize("training", [{"fx": 100.0}, {"fx": 100.0, "fy": 50.0}])
@pytest.mark.parametrize("camera", [{"fx": 90.0}, {"fx": 400.0, "fy": 320.0}, {"fx": 610.0}])
def test_pictures_are_thinned_as_the_agent_does(training, camera):
    size = {"width": 640, "height": 480}
    ours = _choose_thin(Camera(**size, **camera), Camera(**size, **training))
    theirs = choose_thin(*(CameraIntrinsics(**size, **each) for each in (camera, training)))
    assert ours == theirs


def check(runner, recording):
    """The largest difference of actions; everything else is compared at once."""
    largest, steps = 0.0, 0
    for episode in recording.episodes:
        runner.reset()
        for shown, command in episode:
            step = runner.act(**shown)
            assert step.problem == command.problem and step.close == bool(command.close)
            assert command.problem is not None or step.num_points == command.num_points
            assert np.allclose(step.T_base_ee, command.T_base_ee, rtol=0, atol=2e-5)
            assert np.allclose(step.goal, command.goal, rtol=0, atol=5e-5, equal_nan=True)
            largest, steps = max(largest, float(np.abs(step.action - command.action).max())), steps + 1
    assert steps >= 100 and largest <= 1e-5


def test_the_whole_way_gives_the_agent_s_actions(folder, recording):
    check(GraspPolicy(folder / "policy.json", T_ee_camera=T_EE_CAMERA), recording)


def test_a_target_that_leaves_the_picture_gives_the_agent_s_actions(folder):
    """For eight steps of an episode the camera looks through where the target was."""
    steps, horizon = itertools.count(), 30

    def leave(shown):
        if not 8 <= next(steps) % horizon < 16:
            return shown
        return {**shown, "depth": np.full_like(shown["depth"], 2.0), "mask": np.zeros_like(shown["mask"])}

    left = record(episodes=4, spoil=leave)
    assert sum(command.num_points == 1 for episode in left.episodes for _, command in episode) >= 20
    check(GraspPolicy(folder / "policy.json", T_ee_camera=T_EE_CAMERA), left)


def test_a_fine_picture_in_millimetres_with_holes_gives_the_agent_s_actions(folder):
    rng = np.random.default_rng(0)

    def spoil(shown):
        depth = (shown["depth"] * 1000).astype(np.uint16)
        depth[rng.random(depth.shape) < 0.3] = 0
        return {**shown, "depth": depth, "mask": shown["mask"].astype(np.uint8) * 7}

    spoilt = record(camera=WIDE, episodes=4, spoil=spoil, table_height=-0.05)
    camera = {"width": 848, "height": 480, "fx": WIDE.fx, "cx": 430.0, "cy": 236.0}
    runner = GraspPolicy(folder / "policy.json", camera=camera, T_ee_camera=T_EE_CAMERA, table_height=-0.05)
    check(runner, spoilt)


WITHOUT = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "torchgrasp", "tensordict", "torchrl", "scipy", "onnx"):
            raise ImportError(name + " is not to be had here")
sys.meta_path.insert(0, Refuse())
sys.path.insert(0, sys.argv[1])
import numpy as np
from grasp_policy import GraspPolicy
data = np.load(sys.argv[2])
policy = GraspPolicy(sys.argv[1] + "/policy.json", T_ee_camera=data["T_ee_camera"])
shown = zip(data["depth"], data["mask"], data["joints"])
steps = [policy.act(depth, mask, joints=joints) for depth, mask, joints in shown]
print(max(np.abs(step.action - action).max() for step, action in zip(steps, data["action"])))
print(steps[-1].close, "torch" in sys.modules, "torchgrasp" in sys.modules)
"""


def test_it_runs_where_torch_cannot_be_imported(folder, recording, tmp_path):
    shown, said = zip(*recording.episodes[0], strict=True)
    arrays = {name: np.stack([each[name] for each in shown]) for name in ("depth", "mask", "joints")}
    arrays |= {"action": np.stack([each.action for each in said]), "T_ee_camera": T_EE_CAMERA}
    np.savez(tmp_path / "episode.npz", **arrays)
    command = [sys.executable, "-I", "-c", WITHOUT, str(folder), str(tmp_path / "episode.npz")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    difference, told = done.stdout.splitlines()
    assert float(difference) <= 1e-5 and told == "True False False"


def test_it_says_what_it_reads(folder):
    done = subprocess.run(
        [sys.executable, "-I", folder / "grasp_policy.py", folder / "policy.json"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith("30 steps; reads points")


def test_the_smallest_around_a_pixel_is_scipy_s():
    from scipy.ndimage import minimum_filter

    for shape in ((7, 9), (1, 4), (1, 1)):
        picture = np.random.default_rng(0).random(shape)
        assert np.array_equal(_smallest_around(picture), minimum_filter(picture, size=3))


def test_the_hand_follows_from_the_joints(folder):
    runner = GraspPolicy(folder / "policy.json", T_ee_camera=T_EE_CAMERA)
    rng = np.random.default_rng(0)
    for q in READY_POSTURE + rng.uniform(-0.3, 0.3, (20, 7)):
        assert np.allclose(runner._find_hand(q), forward_kinematics(q[None])[0], atol=1e-12)


def picture():
    depth, mask = np.full((112, 112), 0.4, dtype=np.float32), np.zeros((112, 112), dtype=bool)
    mask[50:60, 50:60] = True
    return {"depth": depth, "mask": mask, "joints": READY_POSTURE}


HELD = {
    "depth of 100 x 112 pixels": {"depth": np.ones((112, 100))},
    "mask of 56 x 112 pixels": {"mask": np.ones((112, 56), dtype=bool)},
    "depth has no return at any pixel": {"depth": np.full((112, 112), np.nan)},
    "lie beyond far": {"depth": np.full((112, 112), 400.0)},
    "no point of the target has been seen yet": {"mask": np.zeros((112, 112), dtype=bool)},
    "the picture is 0.90 s old": {"age": 0.9},
}


@pytest.mark.parametrize("told", HELD)
def test_a_picture_that_cannot_be_used_holds_the_hand(folder, told):
    runner = GraspPolicy(folder / "policy.json", T_ee_camera=np.eye(4))
    step = runner.act(**picture() | HELD[told])
    assert told in step.problem and not step.action.any() and not step.close and runner.steps == 0
    assert np.allclose(step.T_base_ee, forward_kinematics(READY_POSTURE[None])[0])


WRONG = {
    "joints and T_base_ee are both missing": {"joints": None},
    "joints of shape": {"joints": np.zeros(6)},
    "joints has NaN": {"joints": np.full(7, np.nan)},
    "joints cannot be read": {"joints": "home"},
    "joint 4 cannot stand at": {"joints": np.zeros(7)},
    "T_base_ee is no rigid pose": {"T_base_ee": 2 * np.eye(4)},
    "T_base_ee of shape": {"T_base_ee": np.eye(3)},
    "needs joints": {"joints": None, "T_base_ee": np.eye(4)},
    "age=-1": {"age": -1.0},
    "depth of type uint8": {"depth": np.ones((112, 112), dtype=np.uint8)},
    "depth of shape": {"depth": np.ones((112, 112, 3))},
    "depth cannot be read": {"depth": [[1.0], [1.0, 2.0]]},
    "mask has values between": {"mask": np.full((112, 112), 0.5)},
}


@pytest.mark.parametrize("told", WRONG)
def test_a_wrong_call_gets_one_clear_message(folder, told):
    runner = GraspPolicy(folder / "policy.json", T_ee_camera=np.eye(4))
    with pytest.raises(PolicyError, match=told):
        runner.act(**picture() | WRONG[told])


def test_a_camera_that_nothing_tells_the_place_of_and_an_episode_that_is_over_are_told(folder):
    with pytest.raises(PolicyError, match="where the camera is"):
        GraspPolicy(folder / "policy.json").act(**picture())
    runner = GraspPolicy(folder / "policy.json", T_ee_camera=np.eye(4))
    closed = [runner.act(**picture()).close for _ in range(runner.horizon)]
    assert closed == [False] * (runner.horizon - 1) + [True]
    with pytest.raises(PolicyError, match="call reset"):
        runner.act(**picture())
    runner.reset()
    assert runner.act(**picture()).problem is None


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"camera": {"width": 3}}, "give width, height and fx"),
        ({"camera": {"width": 3, "height": 3, "fx": "wide"}}, "give width, height and fx"),
        ({"camera": {"width": 3, "height": 3, "fx": -1.0}}, "cannot be"),
        ({"T_ee_camera": np.zeros((4, 4))}, "T_ee_camera is no rigid pose"),
        ({"thin": 0}, "thin=0"),
    ],
)
def test_an_impossible_runner_is_refused(folder, options, told):
    with pytest.raises(PolicyError, match=told):
        GraspPolicy(folder / "policy.json", **options)


def damage(settings, **others):
    return json.dumps({**settings, **others})


DAMAGED = {
    "is damaged": lambda s: "{",
    "is damaged ": lambda s: "[]",
    "is of format 2": lambda s: damage(s, format=2),
    "the transform 'Mirror', unknown here": lambda s: damage(s, transforms=[{"name": "Mirror"}]),
    "does not tell horizon": lambda s: json.dumps({k: v for k, v in s.items() if k != "horizon"}),
    "does not lie beside it": lambda s: damage(s, network="../policy.onnx"),
    "is missing: it lies beside": lambda s: damage(s, network="other.onnx"),
    "is no network": lambda s: damage(s, network="policy.json"),
    "is of another policy": lambda s: damage(s, inputs=["points"]),
    "of another policy": lambda s: damage(s, outputs=["action"]),
}


def copy_with(folder, to, change):
    """An exported policy whose settings were changed, in another folder."""
    (to / "policy.onnx").symlink_to(folder / "policy.onnx")
    (to / "policy.json").write_text(change(json.loads((folder / "policy.json").read_text())))


@pytest.mark.parametrize("told", DAMAGED)
def test_a_damaged_file_is_named(folder, tmp_path, told):
    copy_with(folder, tmp_path, DAMAGED[told])
    with pytest.raises(PolicyError, match=told.strip()):
        GraspPolicy(tmp_path / "policy.json")


def leave_out(part, name):
    return {key: value for key, value in part.items() if key != name}


def change_transform(settings, number, **options):
    rows = list(settings["transforms"])
    rows[number] = rows[number] | options
    return damage(settings, transforms=rows)


NO_NUMBERS = {
    "KeyError('fx')": lambda s: damage(s, camera=leave_out(s["camera"], "fx")),
    "cy=middle": lambda s: damage(s, camera=s["camera"] | {"cy": "middle"}),
    "TypeError": lambda s: damage(s, camera=None),
    "KeyError('seed')": lambda s: damage(s, transforms=[leave_out(e, "seed") for e in s["transforms"]]),
    "KeyError('alpha')": lambda s: damage(s, transforms=[leave_out(e, "alpha") for e in s["transforms"]]),
    "num_points=256.5": lambda s: change_transform(s, 2, num_points=256.5),
    "marked=[[0.0, 1.0]]": lambda s: change_transform(s, 3, marked=[[0.0, 1.0]]),
    "horizon=30": lambda s: damage(s, horizon="30"),
    "horizon=0": lambda s: damage(s, horizon=0),
    "horizon=True": lambda s: damage(s, horizon=True),
    "action_bound=[1.0]": lambda s: damage(s, action_bound=[1.0]),
    "table_guard=nan": lambda s: damage(s, table_guard=float("nan")),
    "hand_boxes=[]": lambda s: damage(s, hand_boxes=[]),
    "joints=[[1.0]]": lambda s: damage(s, arm=s["arm"] | {"joints": [[1.0]]}),
    "KeyError('lowest')": lambda s: damage(s, arm=leave_out(s["arm"], "lowest")),
    "no transform makes the input wrist_angle": lambda s: damage(s, transforms=s["transforms"][:-1]),
    "no output is the action": lambda s: damage(s, outputs=["goal_prediction"]),
}


@pytest.mark.parametrize("told", NO_NUMBERS)
def test_damage_is_told_when_the_policy_is_built(folder, tmp_path, told):
    copy_with(folder, tmp_path, NO_NUMBERS[told])
    with pytest.raises(PolicyError, match=f"is damaged .*{re.escape(told)}") as error:
        GraspPolicy(tmp_path / "policy.json", T_ee_camera=np.eye(4))
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(PolicyError, match=r"policy\.json cannot be read"):
        GraspPolicy(tmp_path / "policy.json")
