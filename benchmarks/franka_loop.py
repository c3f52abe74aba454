"""suite=franka: grasps of a Franka over libfranka's protocol, one line of a file for each."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig

import torchgrasp
from torchgrasp import GraspAgent
from torchgrasp.deploy import ArmLimits, ClosedLoop, FrankaArm, GraspOutcome
from torchgrasp.deploy.rehearsal import Rehearsal, RehearsalCamera, Snapshot
from torchgrasp.deploy.rehearsal_film import draw_rehearsal
from torchgrasp.errors import ConfigError, RenderError, StopError
from torchgrasp.evaluation import SuccessTable
from torchgrasp.objects import ProceduralObjects
from torchgrasp.report.drawing import enlarge, shade_depth, write_caption
from torchgrasp.report.film import write_video
from torchgrasp.sim import CameraIntrinsics, RaycastCamera, View, look_at
from torchgrasp.sim.kinematics import forward_kinematics
from torchgrasp.sim.world import LIFTED

_FRAME = 0.05  # seconds between the frames of a film
_SIZE = 480


def benchmark_franka(cfg: DictConfig) -> list[dict]:
    """The rows of all episodes; those that the file of results has already are not run again."""
    options = cfg.franka
    path = Path(options.results)
    asked = {"policy": str(options.policy), "split": str(options.split), "seed": int(cfg.seed)}
    asked["objects"] = int(options.objects)
    rows = _read(path, asked)
    stage = _Stage(asked, options)
    scene = rows[-1]["scene"] + 1 if rows else 0
    while len(rows) < options.episodes:
        film = options.film if len(rows) == 0 else None
        row = stage.play(scene, film)
        scene += 1
        if row is None:
            continue
        if row["cause"] == "interrupted":
            raise KeyboardInterrupt
        rows.append({**asked, "episode": len(rows), **row})
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(_tell(rows[-1]), flush=True)
    print(json.dumps(summary := summarize(rows), indent=2), flush=True)
    return [summary, *rows]


def summarize(rows: list[dict]) -> dict:
    """Success with its interval, stops by cause, and what the gripper's width says beside the truth."""
    table = SuccessTable()
    for row in rows:
        table.add(row["object"], row["lifted"], cause=None if row["lifted"] else row["cause"] or "slipped")
    whole = table.summary()
    keep = {key: whole[key] for key in ("success_rate", "success_ci95", "episodes")}
    return {
        **keep,
        "lifted": table.successes,
        "stops": dict(Counter(row["cause"] for row in rows if row["cause"])),
        "held_but_not_lifted": sum(row["held"] and not row["lifted"] for row in rows),
        "lifted_but_not_held": sum(row["lifted"] and not row["held"] for row in rows),
    }


def _read(path: Path, asked: dict) -> list[dict]:
    """Rows of a file that was made with the same options; none where there is no file."""
    if not path.exists():
        return []
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    for row in rows:
        if any(row.get(key) != value for key, value in asked.items()):
            told = ", ".join(f"{key}={row.get(key)}" for key in asked)
            raise ConfigError(f"franka.results={path} is of {told}: give another file, or the same options.")
    return rows


def _tell(row: dict) -> str:
    end = f"{row['cause']}: {row['reason']}" if row["cause"] else f"{1000 * row['width']:.1f} mm wide"
    word = "lifted" if row["lifted"] else "not lifted"
    return f"{row['episode']:4d} {row['object']:24s} {word:10s} {row['steps']:3d} steps, {end}"


class _Stage:
    """Objects, starts, policy and camera of the episodes."""

    def __init__(self, asked: dict, options: DictConfig) -> None:
        policy = torchgrasp.load_policy(asked["policy"])
        self._objects = ProceduralObjects(asked["split"], num_objects=asked["objects"])
        env = torchgrasp.make_env(
            policy, objects=self._objects, num_envs=1, seed=asked["seed"], object_order="cycle"
        )
        self._env: Any = env.base_env
        self._camera = RaycastCamera(self._env.cameras["camera"].intrinsics)
        intrinsics, place = self._camera.intrinsics, self._camera.T_ee_camera
        self._agent = GraspAgent(policy, intrinsics=intrinsics, T_ee_camera=place)
        self._limits = ArmLimits()
        self._watchdog = float(options.watchdog)

    def play(self, number: int, film: str | None) -> dict | None:
        """The row of one scene; None where the arm may not stand at its start."""
        scene = self._env.scene(0, number)
        try:
            self._limits.check_joints(scene.q)
            self._limits.check_pose(forward_kinematics(scene.q[None])[0])
        except StopError:
            return None
        target = self._objects[scene.object_id]
        with Rehearsal(target, scene.T_base_object, scene.q, physics=scene.physics) as rehearsal:
            moments: list[Snapshot] = []
            if film is not None:
                rehearsal.watch(lambda now: _keep(moments, now))
            with FrankaArm(rehearsal.host, limits=self._limits, realtime=False) as arm:
                outcome = self._grasp(rehearsal, arm)
            risen = rehearsal.risen
            if film is not None:
                self._film(rehearsal, list(moments), Path(film))
        facts = {"scene": number, "object": target.name, "lifted": risen > LIFTED, "risen": round(risen, 4)}
        width = None if np.isnan(outcome.width) else round(outcome.width, 5)
        return facts | asdict(outcome) | {"width": width}

    def _grasp(self, rehearsal: Rehearsal, arm: FrankaArm) -> GraspOutcome:
        loop = ClosedLoop(
            arm,
            self._agent,
            RehearsalCamera(rehearsal, self._camera),
            watchdog=self._watchdog,
            clock=rehearsal.clock,
        )
        return loop.run()

    def _film(self, rehearsal: Rehearsal, moments: list[Snapshot], path: Path) -> None:
        """The scene in colour, or drawn from rays without OpenGL, and what the camera on the hand sees."""
        try:
            scenes = list(draw_rehearsal(rehearsal, moments, size=_SIZE))
        except RenderError as error:
            print(f"Drawn from rays: {error}", flush=True)
            lens = CameraIntrinsics(_SIZE, _SIZE, fov=0.9, far=5.0)
            outside = RaycastCamera(lens, T_base_camera=look_at((1.25, -0.8, 0.65), (0.42, 0.0, 0.2)))
            scenes = [_draw(outside, rehearsal, moment) for moment in moments]

        def frames() -> Iterator[np.ndarray]:
            for moment, scene in zip(moments, scenes, strict=True):
                wrist = enlarge(_draw(self._camera, rehearsal, moment), _SIZE)
                words = f"{rehearsal.target.name}   {moment.time - moments[0].time:.1f} s"
                yield write_caption(np.hstack((scene, wrist)), words)

        print(f"Film: {write_video(path, frames(), fps=1 / _FRAME)}", flush=True)


def _draw(camera: RaycastCamera, rehearsal: Rehearsal, moment: Snapshot) -> np.ndarray:
    """A camera's depth as a picture, the target in orange."""
    hand = forward_kinematics(moment.joints[None, :7])[0]
    seen = camera.observe(View(rehearsal.target, moment.T_base_object, moment.joints, hand))
    return shade_depth(seen["depth"], seen["mask"], camera.intrinsics)


def _keep(moments: list[Snapshot], now: Snapshot) -> None:
    if not moments or now.time - moments[-1].time >= _FRAME:
        moments.append(now)
