"""A rehearsal in colour, drawn by MuJoCo with the robot's genuine meshes."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator

import numpy as np

from torchgrasp.deploy.rehearsal import Rehearsal, Snapshot
from torchgrasp.errors import RenderError

# From where the scene is seen: metres and degrees about the middle of the table.
_LOOK_AT, _DISTANCE, _AZIMUTH, _ELEVATION = (0.42, 0.0, 0.2), 1.45, 140.0, -22.0


def draw_rehearsal(
    rehearsal: Rehearsal, moments: Iterable[Snapshot], *, size: int = 480
) -> Iterator[np.ndarray]:
    """(size, size, 3) uint8 frames of moments of a rehearsal that has not ended.

    Args:
        rehearsal: whose scene is drawn.
        moments: what stood where.
        size: pixels of a side.

    Raises:
        RenderError: where MuJoCo finds no OpenGL. Without a display it wants the environment variable
            MUJOCO_GL=egl (or osmesa) when Python starts: TorchRL loads it early.
    """
    mujoco = importlib.import_module("mujoco")  # whose types pyright does not know

    model = rehearsal.model
    model.vis.global_.offwidth = max(size, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(size, model.vis.global_.offheight)
    try:
        renderer = mujoco.Renderer(model, size, size)
    except Exception as error:  # of whichever OpenGL there is, each with exceptions of its own
        raise RenderError(
            f"MuJoCo cannot draw here ({error}): start Python with MUJOCO_GL=egl, or osmesa, and have "
            "that library."
        ) from error
    view = mujoco.MjvCamera()
    view.lookat[:], view.distance, view.azimuth, view.elevation = _LOOK_AT, _DISTANCE, _AZIMUTH, _ELEVATION
    data = mujoco.MjData(model)
    try:
        for moment in moments:
            data.qpos[:] = rehearsal.to_qpos(moment)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera=view)
            yield renderer.render().copy()
    finally:
        renderer.close()
