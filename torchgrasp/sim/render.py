"""The rendering camera: depth, target mask and colour through SAPIEN's renderer, on Vulkan."""

from __future__ import annotations

import functools

import numpy as np

from torchgrasp.sim.appearance import Appearance, Randomization, default_appearance
from torchgrasp.sim.camera import T_EE_CAMERA, Camera, CameraIntrinsics, View
from torchgrasp.sim.render_scene import render_scene
from torchgrasp.sim.robot_look import RobotLookName, check_robot, robot_look


class RenderCamera(Camera):
    """Depth, target mask and RGB, rendered; the geometry is that which `RaycastCamera` sees.

    The first picture of a process starts the renderer; the camera itself is plain numbers and can be
    sent to other processes. All rendering cameras of a process that show the same look of the robot share
    one scene.

    Args:
        intrinsics: picture size, field of view and range.
        T_ee_camera: (4, 4) pose of the camera in the hand frame.
        T_base_camera: (4, 4) pose of a static camera in the base frame, which takes the place of the
            former.
        rgb: whether to render colour; depth and mask alone take half the time.
        randomize: ranges from which textures and light are drawn by `View.appearance`; None for one
            look of all episodes.
        robot: "shapes" shows the robot as physics and the other cameras have it, "meshes" for people to
            look at, as the Panda looks: see `torchgrasp.sim.robot_look`.

    Raises:
        RenderError: by `observe`, where no Vulkan device renders.
    """

    def __init__(
        self,
        intrinsics: CameraIntrinsics | None = None,
        *,
        T_ee_camera: np.ndarray = T_EE_CAMERA,
        T_base_camera: np.ndarray | None = None,
        rgb: bool = True,
        randomize: Randomization | None = None,
        robot: RobotLookName = "shapes",
    ) -> None:
        super().__init__(intrinsics, T_ee_camera=T_ee_camera, T_base_camera=T_base_camera)
        self.rgb = rgb
        self.randomize = randomize
        check_robot(robot)
        self.robot: RobotLookName = robot
        self.channels = ("depth", "mask", "rgb") if rgb else ("depth", "mask")

    def observe(self, view: View) -> dict[str, np.ndarray]:
        """Depth, mask and, unless `rgb` is off, colour; see `Camera.observe`."""
        robot = robot_look(self.robot)
        scene = render_scene(robot)
        key = view.target.content_hash
        look = _look(self.randomize, view.appearance, key) if self.rgb else default_appearance(key)
        scene.arrange(view.target, view.T_base_object, robot.poses(view.joints, view.T_base_ee), look)
        return scene.picture(self.intrinsics, self.pose(view.T_base_ee), colour=self.rgb)


@functools.lru_cache(maxsize=64)
def _look(randomize: Randomization | None, appearance: int, target_key: str) -> Appearance:
    """The look of an episode; the last 64 are kept."""
    return randomize.draw(appearance, target_key) if randomize else default_appearance(target_key)
