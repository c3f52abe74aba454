"""recipes/view.py: the page is served, and shows the world as physics has it."""

import re
import socket
import subprocess
import sys
import threading
import time
import urllib.request

import numpy as np
import pytest
import torch
import viser
import zstandard
from viser.transforms import SO3
from websockets.sync.client import connect

from recipes import view
from tests.configurations import compose_config
from tests.recipes.runner import command, environment
from torchgrasp import keys
from torchgrasp.config import evaluation_config, make_policy, make_split_env
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.planning import ExpertPolicy, RandomAction
from torchgrasp.report.viewer import EpisodeViewer
from torchgrasp.report.viewer_panel import Skipped

SMALL = ["objects.num_objects=2", "evaluation.num_objects=2", "objects.num_grasps=100", "env.horizon=4"]
SMALL += ["camera.intrinsics.width=32", "camera.intrinsics.height=32", "num_points=64", "speed=10"]


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """A viewer after two episodes of the expert, its environment, and the expert's table."""
    torch.set_num_threads(1)
    cfg = evaluation_config(compose_config("policy=expert", "episodes=2", *SMALL, recipe="view"))
    env, table = make_split_env(cfg, "test"), SuccessTable()
    with EpisodeViewer(policies=["expert"], port=0, speed=10.0, robot="shapes") as viewer:
        playing = {"expert": make_policy(cfg, "expert")}
        view.play(viewer, env, playing, {"expert": table}, range(2))
        yield viewer, env.base_env, table


def pose_of(handle) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = SO3(np.asarray(handle.wxyz)).as_matrix()
    pose[:3, 3] = handle.position
    return pose


def test_the_robot_stands_where_physics_has_it(played):
    viewer, env, _ = played
    robot = env.worlds._worlds[0]._panda.articulation
    assert robot.qpos[7:].max() < 0.039  # the fingers have closed, and the hand has lifted
    assert len(viewer.scene.robot) == sum(len(link.collision_shapes) for link in robot.links)
    for link in robot.links:
        for shape in link.collision_shapes:
            physical = (link.entity_pose * shape.local_pose).to_transformation_matrix()
            poses = [pose_of(handle) for handle in viewer.scene.robot]
            drawn = min(poses, key=lambda pose: np.linalg.norm(pose[:3, 3] - physical[:3, 3]))
            assert np.allclose(drawn[:3, 3], physical[:3, 3], atol=1e-4)
            if hasattr(shape, "half_length"):  # a capsule lies along SAPIEN's x, along z here
                assert abs(drawn[:3, 2] @ physical[:3, 0]) == pytest.approx(1.0, abs=1e-4)
            else:
                assert np.allclose(drawn[:3, :3], physical[:3, :3], atol=1e-3)


@pytest.mark.pybullet
def test_the_panda_is_drawn_where_physics_has_its_links(played):
    _, env, _ = played
    links = {link.name: link for link in env.worlds._worlds[0]._panda.articulation.links}
    with EpisodeViewer(policies=["expert"], port=0) as viewer:
        look = viewer.scene.look
        assert look.name == "meshes" and len(viewer.scene.robot) == len(look.parts) > len(links)
        viewer.scene.arrange(env.worlds.joints[0], env.worlds.T_base_object[0])
        drawn = np.stack([pose_of(handle) for handle in viewer.scene.robot])
    for name in ("link0", "link3", "link7", "hand"):
        physical = links[name].entity_pose.to_transformation_matrix()
        assert (np.abs(drawn - physical).max(axis=(1, 2)) < 1e-3).any(), name


def test_the_target_is_the_objects_mesh_where_physics_has_it(played):
    viewer, env, table = played
    target = env.worlds._worlds[0].placement.target
    assert target.name in table.rows()
    assert np.allclose(pose_of(viewer.scene.target), env.worlds.T_base_object[0], atol=1e-5)
    drawn = viewer.scene.target.vertices[viewer.scene.target.faces.astype(int)]
    area = np.linalg.norm(np.cross(drawn[:, 1] - drawn[:, 0], drawn[:, 2] - drawn[:, 0]), axis=-1).sum() / 2
    mesh = target.vertices[target.faces]
    whole = np.linalg.norm(np.cross(mesh[:, 1] - mesh[:, 0], mesh[:, 2] - mesh[:, 0]), axis=-1).sum() / 2
    assert area == pytest.approx(2 * whole, rel=1e-4)  # seen from both sides
    assert np.allclose(drawn.reshape(-1, 3).min(0), mesh.reshape(-1, 3).min(0), atol=1e-6)
    assert np.allclose(drawn.reshape(-1, 3).max(0), mesh.reshape(-1, 3).max(0), atol=1e-6)


def test_the_page_tells_of_both_episodes(played):
    viewer, env, table = played
    assert table.episodes == 2
    assert f"lifted {table.successes} of 2" in viewer.panel.success.value
    assert viewer.panel.time_left.value == 0.0
    assert viewer.panel.target.value == env.worlds._worlds[0].placement.target.name


def test_cloud_and_grasps_are_drawn_in_the_hand_that_saw_them(played):
    viewer, env, _ = played
    state = env.reset()[0]
    goal = torch.tensor([0.0, 0.0, 0.1, 0.0, 0.0, 1.0, 0.0])
    cloud = torch.zeros(5, 4)
    cloud[:2, :3], cloud[2, 2:] = torch.rand(2, 3), 1.0  # two points, a gripper point, two rows filled in
    state.update({keys.GOAL: goal, keys.HAS_GOAL: torch.tensor([False]), keys.POINTS: cloud})
    state[keys.GOAL_PREDICTION] = goal
    viewer.show(state, env)
    T_base_ee = env.worlds.T_base_ee[0]
    assert np.allclose(viewer.scene.cloud.points, cloud[:2, :3])
    assert np.allclose(pose_of(viewer.scene.cloud), T_base_ee, atol=1e-5)
    grasp = pose_of(viewer.scene.grasps[keys.GOAL_PREDICTION])
    assert np.allclose(grasp[:3, 3], T_base_ee[:3, 3] + 0.1 * T_base_ee[:3, 2], atol=1e-5)
    assert np.allclose(grasp[:3, 0], -T_base_ee[:3, 0], atol=1e-5)  # turned by 180 degrees about z
    assert viewer.scene.grasps[keys.GOAL_PREDICTION].visible and not viewer.scene.grasps[keys.GOAL].visible
    viewer.show(state.exclude(keys.POINTS, keys.GOAL_PREDICTION), env)
    assert len(viewer.scene.cloud.points) == 0 and not viewer.scene.grasps[keys.GOAL_PREDICTION].visible


def test_a_pause_holds_and_next_leaves_an_episode(played):
    viewer, env, _ = played
    viewer.panel.pause.value = True
    watched = viewer.watch(RandomAction(), env)
    threading.Timer(0.3, viewer.panel.skip).start()
    began = time.monotonic()
    with pytest.raises(Skipped):
        env.rollout(3, watched)
    assert time.monotonic() - began >= 0.3 and viewer.panel.state.content.endswith("step 0 of 4")
    viewer.panel.pause.value = False
    assert len(env.rollout(3, watched)[0]) == 3


def test_watching_changes_nothing(played):
    viewer, env, _ = played
    episodes = []
    for watch in (False, True):
        policy = ExpertPolicy(env.objects, horizon=env.horizon)
        env.start_episodes_at([7])
        episodes.append(env.rollout(4, viewer.watch(policy, env) if watch else policy))
    assert torch.equal(episodes[0][keys.ACTION], episodes[1][keys.ACTION])
    assert torch.equal(episodes[0]["next", keys.JOINTS], episodes[1]["next", keys.JOINTS])
    assert episodes[0][keys.ACTION].abs().sum() > 0


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


def test_a_browser_gets_the_page_and_the_scene(tmp_path):
    port = free_port()
    options = ["policy=expert", "episodes=2", f"port={port}", *SMALL, "speed=4"]
    process = subprocess.Popen(command("view", tmp_path, *options), stdout=-1, text=True, env=environment())
    assert process.stdout is not None
    address = f"http://127.0.0.1:{port}"
    assert address in process.stdout.readline()
    page = urllib.request.urlopen(address, timeout=10).read()
    assert b"<html" in page
    protocol = f"viser-v{viser.__version__}"
    with connect(address.replace("http", "ws"), subprotocols=[protocol], max_size=None) as client:  # pyright: ignore
        names: set[bytes] = set()
        while not {b"/robot/0", b"/robot/17", b"/furniture/0"} <= names:
            names |= set(re.findall(rb"/[a-z]+/[0-9]+", unpacked(client.recv(timeout=10))))
    assert "of 2" in process.communicate(timeout=60)[0] and process.returncode == 0
    assert not list(tmp_path.iterdir())


def unpacked(message: str | bytes) -> bytes:
    """The packed part of a message of viser: two lengths of 8 bytes, then zstd."""
    assert isinstance(message, bytes)
    return zstandard.ZstdDecompressor().decompress(message[16 : 16 + int.from_bytes(message[8:16], "little")])


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"port": 70000}, "port=70000"),
        ({"port": -1}, "port=-1"),
        ({"host": "192.0.2.1", "port": 0}, "host=192.0.2.1"),
        ({"port": 0, "speed": 0.0}, "speed=0.0"),
        ({"port": 0, "robot": "boxes"}, "robot='boxes'"),
    ],
)
def test_what_cannot_be_served_is_refused_by_name(options, told):
    with pytest.raises(ConfigError, match=told):
        EpisodeViewer(policies=["expert"], **options)


def test_a_port_that_is_taken_is_named_before_anything_is_prepared(composed):
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        with pytest.raises(ConfigError, match=f"port={taken} .*port=0"):
            view.view(composed("policy=random", f"port={taken}", *SMALL, recipe="view"))


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ConfigError, match=r"pip install \"torchgrasp\[viz\]\""):
        EpisodeViewer(policies=["expert"])


def test_a_page_shows_one_world(composed):
    with pytest.raises(ConfigError, match=r"evaluation\.num_envs=2"):
        view.view(composed("policy=random", "evaluation.num_envs=2", recipe="view"))
