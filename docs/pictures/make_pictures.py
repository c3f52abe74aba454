"""The pictures of the documentation: python docs/pictures/make_pictures.py [folder], its own by default.

Needs a renderer (`python -m torchgrasp doctor`) and the extras ycb, random-urdfs, acronym and viz. The first
run prepares some thirty objects.
"""

from __future__ import annotations

import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from contact_sheet import Tile, coloured, sheet
from object_sets import picture_objects
from omegaconf import OmegaConf

from torchgrasp import keys
from torchgrasp.config import build, one_line_errors
from torchgrasp.envs import GraspEnv, HandoverTarget, TabletopStart
from torchgrasp.objects import YcbObjects
from torchgrasp.objects.model import GraspObject
from torchgrasp.planning import ExpertPolicy
from torchgrasp.report.drawing import enlarge, shade_depth
from torchgrasp.sim import CameraIntrinsics, Physics, Randomization, RenderCamera, View, look_at

_HERE = Path(__file__).resolve().parent
_CONF = _HERE.parents[1] / "conf"
_OUTSIDE = RenderCamera(
    CameraIntrinsics(320, 256, fov=0.85, near=0.05, far=6.0),
    T_base_camera=look_at((1.4, -0.85, 0.75), (0.35, 0.0, 0.3)),
    robot="meshes",
)


def view(env: GraspEnv, appearance: int = 0) -> View:
    """The present state of the environment's first world."""
    worlds, episode = env.worlds, env.episodes_started[0]
    target = env.objects[env.scene(0, episode).object_id]
    return View(target, worlds.T_base_object[0], worlds.joints[0], worlds.T_base_ee[0], appearance)


def picture_cameras(folder: Path, target: GraspObject) -> None:
    """Every camera of conf/camera and conf/overhead on one scene."""
    make = {name: _configured(name) for name in ("camera/raycast", "camera/render")}
    make |= {f"overhead/{kind}": _configured(f"overhead/{kind}") for kind in ("raycast", "render")}
    env = GraspEnv(1, objects=[target], seed=6)
    env.rollout(12, ExpertPolicy(env.objects, horizon=env.horizon))
    seen = {name: camera.observe(view(env)) for name, camera in make.items()}
    lens = make["overhead/raycast"].intrinsics
    rays, over = seen["camera/raycast"], seen["overhead/raycast"]
    mask = np.where(rays["mask"][..., None], np.uint8(255), np.zeros(3, np.uint8))
    tiles = [
        ("raycast: depth", coloured(rays["depth"])),
        ("raycast: mask", mask),
        ("render: depth", coloured(seen["camera/render"]["depth"])),
        ("render: rgb", seen["camera/render"]["rgb"]),
    ]
    randomised = RenderCamera(randomize=Randomization())
    tiles += [(f"randomised {i}", randomised.observe(view(env, i))["rgb"]) for i in (1, 2, 3, 4)]
    tiles += [
        ("overhead raycast: depth", coloured(over["depth"])),
        ("overhead, shaded", shade_depth(over["depth"], over["mask"], lens)),
        ("overhead render: rgb", seen["overhead/render"]["rgb"]),
    ]
    tiles.append(("from outside", outside(env)[:, :256]))
    sheet(folder / "cameras.jpg", [(name, enlarge(each, 224)) for name, each in tiles], columns=4)


def _configured(name: str) -> Any:
    """What conf/<name>.yaml describes."""
    return build(OmegaConf.load(_CONF / f"{name}.yaml"))


def outside(env: GraspEnv) -> np.ndarray:
    """The environment's first world as it stands."""
    return _OUTSIDE.observe(view(env))["rgb"]


def after(steps: int, env: GraspEnv) -> np.ndarray:
    """What is seen after so many steps in which the hand keeps still."""
    td = env.reset()
    for _ in range(steps):
        td = env.step(td.set(keys.ACTION, torch.zeros(env.action_spec.shape)))["next"]
    return outside(env)


def lifted(target: GraspObject, physics: Physics) -> Tile:
    """The end of an expert's episode."""
    env = GraspEnv(1, objects=[target], seed=4, physics=physics)
    episode = env.rollout(env.horizon, ExpertPolicy(env.objects, horizon=env.horizon))
    word = "lifted" if float(episode["next", "reward"].sum()) > 0 else "slipped"
    return f"friction {physics.friction}, fingers {physics.finger_friction}: {word}", outside(env)


def picture_tasks(folder: Path, target: GraspObject) -> None:
    """Every start, target motion and a changed physics, one frame each."""
    make = partial(GraspEnv, objects=[target], seed=0)
    jitter = make(seed=5, target_motion="jitter")
    tiles = [
        ("start=facing, target static", after(0, make())),
        ("start=fixed", after(0, make(start=TabletopStart()))),
        ("start=varied", after(0, make(start=TabletopStart(spread=0.25)))),
        ("jitter: start", after(0, jitter)),
    ]
    jitter.start_episodes_at([0])
    tiles.append(("jitter: after 12 steps", after(12, jitter)))
    for route in ("left", "middle", "right"):
        held = make(seed=3, target_motion=HandoverTarget(route))
        tiles.append((f"handover: {route}", after(0, held)))
    for steps in (0, 8, 15):
        moving = make(seed=3, target_motion=HandoverTarget("left_to_right"))
        tiles.append((f"left_to_right: step {steps}", after(steps, moving)))
    tiles.append(lifted(target, Physics(friction=0.3, finger_friction=0.3)))
    sheet(folder / "tasks.jpg", tiles, columns=3)


@one_line_errors()
def main(folder: Path) -> None:
    """Write all three sheets."""
    folder.mkdir(parents=True, exist_ok=True)
    target = YcbObjects("test")[3]
    picture_cameras(folder, target)
    picture_tasks(folder, target)
    with tempfile.TemporaryDirectory() as meshes:
        picture_objects(folder, Path(meshes))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else _HERE)
