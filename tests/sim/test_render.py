"""The rendering camera: the same geometry as the rays, one look an episode, one scene a process."""

import multiprocessing
import os
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.sim.states import OVERHEAD, views
from torchgrasp.errors import ConfigError
from torchgrasp.objects import ProceduralObjects
from torchgrasp.sim import CameraIntrinsics, Randomization, RaycastCamera, RenderCamera, View
from torchgrasp.sim.render_scene import render_scene
from torchgrasp.sim.robot_look import robot_look

PLACES = {"wrist": {}, "overhead": OVERHEAD}


@pytest.fixture(scope="module")
def targets():
    objects = ProceduralObjects("train", num_objects=8, num_grasps=100)
    return [objects[i] for i in range(8)]


def same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(one[channel], other[channel]) for channel in one)


@pytest.mark.vulkan
@pytest.mark.parametrize("rgb", [True, False])
@pytest.mark.parametrize("place", PLACES)
def test_both_cameras_agree_within_a_millimetre_on_99_percent_of_the_pixels(targets, place, rgb):
    rays, renderer = RaycastCamera(**PLACES[place]), RenderCamera(rgb=rgb, **PLACES[place])
    marked, off, wrong = 0, [], []
    for view in views(targets, 30 if rgb else 80):
        expected, seen = rays.observe(view), renderer.observe(view)
        off.append((np.abs(expected["depth"] - seen["depth"]) > 1e-3).mean())
        wrong.append((expected["mask"] != seen["mask"]).mean())
        marked += seen["mask"].any()
    assert np.mean(off) < 0.01 and np.mean(wrong) < 0.001
    assert np.quantile(off, 0.9) < 0.01 and max(wrong) < 0.01
    assert marked > len(off) / 2


@pytest.mark.vulkan
def test_shapes_and_types_are_those_of_every_camera(targets):
    view = next(views(targets, 1))
    picture = RenderCamera(CameraIntrinsics(40, 30)).observe(view)
    assert {k: (v.shape, v.dtype) for k, v in picture.items()} == {
        "depth": ((30, 40), np.dtype(np.float32)),
        "mask": ((30, 40), np.dtype(bool)),
        "rgb": ((30, 40, 3), np.dtype(np.uint8)),
    }
    assert tuple(picture) == RenderCamera().channels
    assert (
        tuple(RenderCamera(rgb=False).observe(view)) == RenderCamera(rgb=False).channels == ("depth", "mask")
    )


@pytest.mark.vulkan
def test_a_picture_depends_on_the_view_alone(targets):
    wrist, overhead = RenderCamera(randomize=Randomization()), RenderCamera(**OVERHEAD)
    states = list(views(targets, 6))
    first = [wrist.observe(view) for view in states]
    for view in reversed(states):
        overhead.observe(view)
    again = [wrist.observe(view) for view in reversed(states)][::-1]
    assert all(same(a, b) for a, b in zip(first, again, strict=True))


@pytest.mark.vulkan
def test_the_appearance_changes_colours_and_nothing_else(targets):
    camera = RenderCamera(randomize=Randomization(), **OVERHEAD)
    view = next(views(targets, 1))
    looks = [
        camera.observe(View(view.target, view.T_base_object, view.joints, view.T_base_ee, seed))
        for seed in (3, 4, 3)
    ]
    assert same(looks[0], looks[2]) and np.array_equal(looks[0]["depth"], looks[1]["depth"])
    change = np.abs(looks[0]["rgb"].astype(int) - looks[1]["rgb"]).max(-1)
    assert np.mean(change > 8) > 0.8


@pytest.mark.vulkan
def test_without_randomisation_all_episodes_look_alike(targets):
    camera = RenderCamera(CameraIntrinsics(32, 32))
    view = next(views(targets, 1))
    other = View(view.target, view.T_base_object, view.joints, view.T_base_ee, 99)
    assert same(camera.observe(view), camera.observe(other))


@pytest.mark.vulkan
def test_only_some_targets_and_textures_are_kept(brick):
    camera = RenderCamera(CameraIntrinsics(16, 16), randomize=Randomization())
    scene = render_scene(robot_look("shapes"))
    sizes = np.linspace(0.8, 1.2, 60, dtype=np.float32)
    many = [
        replace(brick, vertices=brick.vertices * s, content_hash=f"{i:032x}") for i, s in enumerate(sizes)
    ]
    entities = len(scene._scene.entities)
    for view in views(many, 60):
        camera.observe(view)
    assert len(scene._targets) <= 32 and len(scene._textures) <= 48
    assert len(scene._scene.entities) <= entities + 2  # one target more, one camera more


def _picture_of(camera: RenderCamera, view: View) -> dict[str, np.ndarray]:
    return camera.observe(view)


@pytest.mark.vulkan
def test_a_camera_that_is_sent_to_another_process_gives_the_same_picture(targets):
    camera = RenderCamera(CameraIntrinsics(32, 32), rgb=False)  # shading takes seconds to start
    view = next(views(targets, 1))
    here = camera.observe(view)
    assert same(pickle.loads(pickle.dumps(camera)).observe(view), here)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert same(pool.apply(_picture_of, (camera, view)), here)


@pytest.mark.vulkan
def test_a_forked_process_is_told_what_to_do(targets):
    script = (
        "import os, sys, warnings; warnings.simplefilter('ignore')\n"
        "from torchgrasp.sim.render_scene import render_scene\n"
        "from torchgrasp.sim.robot_look import robot_look\n"
        "from torchgrasp.errors import RenderError\n"
        "render_scene(robot_look('shapes'))\n"
        "pid = os.fork()\n"
        "if pid: sys.exit(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))\n"
        "try: render_scene(robot_look('shapes'))\n"
        "except RenderError as error: os._exit(7 if 'spawn' in str(error) else 8)\n"
        "os._exit(9)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 7 and done.stderr == ""


def test_without_vulkan_the_first_picture_says_what_to_install(targets, tmp_path):
    # The loader is pointed at no driver at all, in a process of its own.
    view = tmp_path / "view.pickle"
    view.write_bytes(pickle.dumps(next(views(targets, 1))))
    script = (
        "import pickle, sys\n"
        "from torchgrasp.sim import RenderCamera, RaycastCamera, probe_renderer\n"
        "from torchgrasp.errors import RenderError\n"
        "view = pickle.loads(open(sys.argv[1], 'rb').read())\n"
        "RaycastCamera().observe(view)\n"
        "probe = probe_renderer()\n"
        "assert not probe.ok and probe.device is None and 'mesa-vulkan-drivers' in probe.error\n"
        "for _ in range(2):\n"
        "    try: RenderCamera().observe(view)\n"
        "    except RenderError as error: assert 'mesa-vulkan-drivers' in str(error)\n"
        "    else: sys.exit(3)\n"
    )
    nowhere = {"VK_ICD_FILENAMES": "/nowhere.json", "VK_DRIVER_FILES": "/nowhere.json"}
    done = subprocess.run(
        [sys.executable, "-c", script, str(view)],
        env={**os.environ, **nowhere},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "options",
    [{"light": (2.0, 1.0)}, {"robot": (0.0, 1.5)}, {"light_tint": -0.1}, {"ambient": (0.1, 0.2, 0.3)}],
)
def test_impossible_ranges_are_refused(options):
    with pytest.raises(ConfigError, match=f"^{next(iter(options))}"):
        Randomization(**options)
