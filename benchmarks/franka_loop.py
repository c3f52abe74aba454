"""suite=franka: grasps of a Franka over libfranka's protocol, one line of a file for each."""

from __future__ import annotations

import json
import os
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
_MOST_LEFT_OUT = 100  # scenes in a row: by then the next ones are no better
_BEGINS = b'{"policy": '  # every row


def benchmark_franka(cfg: DictConfig, limits: ArmLimits | None = None) -> list[dict]:
    """The rows of all episodes; those that the file of results has already are not run again.

    Raises:
        ConfigError: where the file is of other options or damaged, or no scene suits the arm's limits.
    """
    options = cfg.franka
    path = Path(options.results)
    asked = {"policy": str(options.policy), "split": str(options.split), "seed": int(cfg.seed)}
    asked |= {"objects": int(options.objects), "watchdog": float(options.watchdog)}
    rows = read_rows(path, asked)
    stage = _Stage(asked, limits or ArmLimits())
    scene, left_out = rows[-1]["scene"] + 1 if rows else 0, 0
    while len(rows) < options.episodes:
        film = options.film if len(rows) == 0 else None
        row = stage.play(scene, film)
        scene += 1
        if isinstance(row, StopError):
            left_out += 1
            _check_some_suit(left_out, row)
            continue
        if row["cause"] == "interrupted":
            raise KeyboardInterrupt
        rows.append({**asked, "episode": len(rows), "left_out": left_out, **row})
        left_out = 0
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(_tell(rows[-1]), flush=True)
    print(json.dumps(summary := summarize(rows), indent=2), flush=True)
    return [summary, *rows]


def _check_some_suit(left_out: int, reason: StopError) -> None:
    """Refuse to look on where no scene suits the arm."""
    if left_out == _MOST_LEFT_OUT:
        raise ConfigError(
            f"The arm may not stand at the start of any of {left_out} scenes in a row (of the last, "
            f"{reason}): give another franka.policy, for the starts are those that it was trained with."
        )


def summarize(rows: list[dict]) -> dict:
    """Success with its interval, outcomes, and what the gripper's width says beside the truth.

    `left_out` counts scenes whose start the arm may not stand at; they are no episodes.
    """
    table = SuccessTable()
    for row in rows:
        table.add(row["object"], row["lifted"], cause=None if row["lifted"] else name_outcome(row))
    whole = table.summary()
    keep = {key: whole[key] for key in ("success_rate", "success_ci95", "episodes")}
    return {
        **keep,
        "lifted": table.successes,
        "left_out": sum(row["left_out"] for row in rows),
        "outcomes": dict(Counter(name_outcome(row) for row in rows)),
        "stops": dict(Counter(row["cause"] for row in rows if row["cause"])),
        "held_but_not_lifted": sum(row["held"] and not row["lifted"] for row in rows),
        "lifted_but_not_held": sum(row["lifted"] and not row["held"] for row in rows),
    }


def name_outcome(row: dict) -> str:
    """How an episode ended: lifted, why the arm was stopped, slipped after it was caught, or missed."""
    if row["lifted"]:
        return "lifted"
    return row["cause"] or ("slipped" if row["caught"] else "missed")


def read_rows(path: Path, asked: dict) -> list[dict]:
    """Rows of a file that was made with the same options; none where there is no file.

    A last line that was being written when the run was killed is dropped, from the file too.

    Raises:
        ConfigError: where the file is of other options, or damaged.
    """
    if not path.exists():
        return []
    lines = path.read_bytes().splitlines(keepends=True)
    half = lines.pop() if lines and _is_half(lines[-1]) else b""
    rows = [_read_row(line, path, number) for number, line in enumerate(lines, start=1)]
    for row in rows:
        if any(row.get(key) != value for key, value in asked.items()):
            told = ", ".join(f"{key}={row.get(key)}" for key in asked)
            raise ConfigError(f"franka.results={path} is of {told}: give another file, or the same options.")
    if half:
        print(f"{path}: the last line was half written and is dropped; its episode is run again.", flush=True)
        os.truncate(path, sum(map(len, lines)))
    return rows


def _is_half(line: bytes) -> bool:
    """Whether a line is the beginning of a row whose writing was cut off."""
    return not line.endswith(b"\n") and _BEGINS.startswith(line[: len(_BEGINS)])


def _read_row(line: bytes, path: Path, number: int) -> dict:
    try:
        row = json.loads(line)
    except ValueError as error:
        raise ConfigError(f"franka.results={path} is damaged in line {number}: give another file.") from error
    if not isinstance(row, dict):
        raise ConfigError(f"franka.results={path} holds no row in line {number}: give another file.")
    return row


def _tell(row: dict) -> str:
    end = f"{row['cause']}: {row['reason']}" if row["cause"] else f"{1000 * row['width']:.1f} mm wide"
    return f"{row['episode']:4d} {row['object']:24s} {name_outcome(row):10s} {row['steps']:3d} steps, {end}"


class _Stage:
    """Objects, starts, policy, camera and limits of the episodes."""

    def __init__(self, asked: dict, limits: ArmLimits) -> None:
        policy = torchgrasp.load_policy(asked["policy"])
        self._objects = ProceduralObjects(asked["split"], num_objects=asked["objects"])
        env = torchgrasp.make_env(
            policy, objects=self._objects, num_envs=1, seed=asked["seed"], object_order="cycle"
        )
        self._env: Any = env.base_env
        self._camera = RaycastCamera(self._env.cameras["camera"].intrinsics)
        intrinsics, place = self._camera.intrinsics, self._camera.T_ee_camera
        self._agent = GraspAgent(policy, intrinsics=intrinsics, T_ee_camera=place)
        self._limits = limits
        self._watchdog = asked["watchdog"]

    def play(self, number: int, film: str | None) -> dict | StopError:
        """The row of one scene; why the arm may not stand at its start, where that is so."""
        scene = self._env.scene(0, number)
        try:
            self._limits.check_joints(scene.q)
            self._limits.check_pose(forward_kinematics(scene.q[None])[0])
        except StopError as error:
            print(f"     scene {number} is left out: {error}", flush=True)
            return error
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
