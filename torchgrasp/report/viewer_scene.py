"""The three-dimensional part of the viewer's page: robot, table, target, cloud and grasps of one world."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from torchgrasp.geometry import pose_to_goal
from torchgrasp.objects.model import GraspObject
from torchgrasp.report.drawing import hand_lines
from torchgrasp.sim.kinematics import forward_kinematics
from torchgrasp.sim.robot_look import RobotLookName, robot_look
from torchgrasp.sim.scene_parts import FLOOR, Part, furniture
from torchgrasp.sim.table import TABLE_LOWER, TABLE_UPPER
from torchgrasp.sim.visuals import Visual, mesh_visual, rectangle_visual

if TYPE_CHECKING:
    import viser

# Metres: of a point of the cloud, and of the lines of a grasp.
_POINT, _LINE = 0.004, 0.004
_TABLE_TOP, _TARGET, _CLOUD = (0.58, 0.50, 0.42), (0.92, 0.59, 0.24), (0.05, 0.25, 0.85)
# So much of the target covers what is behind it: half of the cloud lies a hair below its surface.
_OPACITY = 0.6
# From where a page looks at first, metres in the base frame, and its vertical field of view, radians.
_EYE, _AIM, _FOV = (1.25, -0.85, 0.65), (0.42, 0.0, 0.22), 0.8


class ViewerScene:
    """Draws one world into a viser server; everything stands in the base frame.

    Args:
        server: whose scene is filled; it is emptied of nothing.
        robot: which look of the robot is drawn, see `torchgrasp.sim.robot_look`.

    Attributes:
        look: of the robot.
        robot: handles of the P parts of its look.
        target: handle of the object's mesh, None before the first.
        cloud: handle of the observed points, posed by the hand that they were observed from.
        grasps: handles by name of the grasps drawn.
    """

    def __init__(self, server: viser.ViserServer, *, robot: RobotLookName = "meshes") -> None:
        self._scene = server.scene
        server.initial_camera.position, server.initial_camera.look_at = _EYE, _AIM
        server.initial_camera.fov = _FOV
        self._scene.add_grid("/floor", 6.0, 6.0, position=(0.0, 0.0, FLOOR), cell_size=0.25, section_size=1.0)
        top = Part(rectangle_visual(TABLE_LOWER, TABLE_UPPER, repeats=0.0), _TABLE_TOP)
        for index, part in enumerate((top, *furniture())):
            self._add(f"/furniture/{index}", part.visual, part.colour).position = np.array(part.position)
        self.look = robot_look(robot)
        self.robot = [
            self._add(f"/robot/{index}", part.visual, part.colour)
            for index, part in enumerate(self.look.parts)
        ]
        self.target: viser.MeshHandle | None = None
        self.cloud = self._scene.add_point_cloud(
            "/cloud",
            np.zeros((0, 3), np.float32),
            _rgb(_CLOUD),
            point_size=_POINT,
            point_shape="circle",
            precision="float32",
            point_shading="flat",
        )
        self.grasps: dict[str, viser.LineSegmentsHandle] = {}
        self._shown = ""

    def show_target(self, target: GraspObject) -> None:
        """Let `target` be the one object that is there."""
        if target.content_hash != self._shown:
            visual = mesh_visual(target.vertices, target.faces, repeats=0.0)
            self.target = self._add("/target", visual, _TARGET)
            self.target.opacity = _OPACITY
            self._shown = target.content_hash

    def arrange(self, joints: np.ndarray, T_base_object: np.ndarray) -> None:
        """Move the robot to joints (9,) and the target to its pose (4, 4)."""
        poses = self.look.poses(joints, forward_kinematics(joints[None, :7])[0])
        for handle, pose in zip(self.robot, poses, strict=True):
            _put(handle, pose)
        if self.target is not None:
            _put(self.target, T_base_object)

    def show_cloud(self, points: np.ndarray, T_base_ee: np.ndarray) -> None:
        """Show points (N, 3) of the hand frame whose pose is (4, 4)."""
        _put(self.cloud, T_base_ee)
        self.cloud.points = points.astype(np.float32)

    def show_grasp(
        self, name: str, T_base_grasp: np.ndarray | None, colour: tuple[float, float, float]
    ) -> None:
        """Outline the gripper at a pose (4, 4), by X_g of Eq. (2); None takes the outline away."""
        if name not in self.grasps:
            self.grasps[name] = self._scene.add_line_segments(
                f"/grasps/{name}", hand_lines().astype(np.float32), _rgb(colour), thickness=_LINE
            )
        self.grasps[name].visible = T_base_grasp is not None
        if T_base_grasp is not None:
            _put(self.grasps[name], T_base_grasp)

    def _add(self, name: str, visual: Visual, colour: tuple[float, float, float]) -> viser.MeshHandle:
        return self._scene.add_mesh_simple(name, visual.vertices, visual.faces, color=_rgb(colour))


def _rgb(colour: tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (round(255 * each) for each in colour)
    return red, green, blue


def _put(handle: viser.SceneNodeHandle, pose: np.ndarray) -> None:
    goal = pose_to_goal(torch.from_numpy(pose)).numpy()
    handle.position, handle.wxyz = goal[:3], goal[[6, 3, 4, 5]]
