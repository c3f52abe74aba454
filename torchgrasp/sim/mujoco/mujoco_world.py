"""One MuJoCo scene: a Panda, the table and one target object."""

from __future__ import annotations

from typing import Any

import numpy as np

from torchgrasp.errors import UnstableError
from torchgrasp.sim.mujoco._mujoco import mujoco
from torchgrasp.sim.mujoco.arm_drives import ArmDrives
from torchgrasp.sim.mujoco.scene_model import Contact, make_scene
from torchgrasp.sim.panda_tables import FINGER_OPEN
from torchgrasp.sim.world import Placement, World

_ROBOT = 9  # joints of arm and hand, which come first
_UNSTABLE = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC")  # after which MuJoCo begins anew


def _ignore(_: str) -> None:
    """Say nothing of a warning: those that matter are raised."""


class MujocoWorld(World):
    """A `World` in MuJoCo.

    A held target is a body that no force moves. To let it go, the scene goes on in a second model, in which
    it is free.

    Args:
        placement: how the episode begins.
        contact: how contacts are solved.
        substeps: MuJoCo's steps in each physics step.
    """

    def __init__(self, placement: Placement, contact: Contact, *, substeps: int) -> None:
        super().__init__(placement)
        self._contact, self._substeps = contact, substeps
        self._unstable = [int(getattr(mujoco.mjtWarning, name)) for name in _UNSTABLE]
        self._drives = ArmDrives(placement.q)
        self._enter(held=placement.held, T_base_object=placement.T_base_object)
        self._data.qpos[:7], self._data.qpos[7:_ROBOT] = placement.q, FINGER_OPEN
        self._lead_fingers(FINGER_OPEN)
        mujoco.mj_forward(self._model, self._data)  # the drives ask for the forces on the arm

    def _enter(self, *, held: bool, T_base_object: np.ndarray) -> None:
        """Begin with fresh data in the model in which the target is held, or free."""
        scene = make_scene(self.placement.target, self.placement.physics, self._contact, held=held)
        self._model: Any = scene.model
        self._data: Any = scene.data
        self._T_object_body = scene.T_object_principal
        self._T_body_object = np.linalg.inv(scene.T_object_principal)
        self._held = held
        self._set_pose(T_base_object)

    def _set_pose(self, T_base_object: np.ndarray) -> None:
        T_base_body = np.asarray(T_base_object, np.float64) @ self._T_object_body
        turned = np.zeros(4)
        mujoco.mju_mat2Quat(turned, T_base_body[:3, :3].ravel())
        if self._held:
            self._data.mocap_pos[0], self._data.mocap_quat[0] = T_base_body[:3, 3], turned
        else:
            self._data.qpos[_ROBOT : _ROBOT + 3], self._data.qpos[_ROBOT + 3 :] = T_base_body[:3, 3], turned

    @property
    def joints(self) -> np.ndarray:
        """(9,) arm angles and finger positions."""
        return self._data.qpos[:_ROBOT].copy()

    @property
    def joint_velocities(self) -> np.ndarray:
        """(9,) rates of `joints`."""
        return self._data.qvel[:_ROBOT].copy()

    @property
    def T_base_object(self) -> np.ndarray:
        """(4, 4) pose of the target."""
        data, turned = self._data, np.empty(9)
        place = data.mocap_pos[0] if self._held else data.qpos[_ROBOT : _ROBOT + 3]
        mujoco.mju_quat2Mat(turned, data.mocap_quat[0] if self._held else data.qpos[_ROBOT + 3 :])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned.reshape(3, 3), place
        return pose @ self._T_body_object

    @property
    def held(self) -> bool:
        """Whether the target stands where it is put."""
        return self._held

    def _lead_arm(self, q: np.ndarray) -> None:
        self._drives.q = q

    def _lead_arm_velocity(self, rate: np.ndarray) -> None:
        self._drives.rate = rate

    def _lead_fingers(self, opening: float) -> None:
        self._data.ctrl[7:] = opening

    def _put_target(self, T_base_object: np.ndarray) -> None:
        self._set_pose(T_base_object)
        self._data.qvel[_ROBOT:] = 0.0

    def _carry_target(self, T_base_object: np.ndarray) -> None:
        self._set_pose(T_base_object)

    def _let_go(self) -> None:
        before, T_base_object = self._data, self.T_base_object
        self._enter(held=False, T_base_object=T_base_object)
        for name in ("qpos", "qvel", "qacc_warmstart"):
            getattr(self._data, name)[:_ROBOT] = getattr(before, name)[:_ROBOT]
        self._data.ctrl[:] = before.ctrl
        mujoco.mj_forward(self._model, self._data)

    def _advance(self, rate: int) -> None:
        self._model.opt.timestep = 1.0 / (rate * self._substeps)
        data = self._data
        # MuJoCo would print a warning, and write it to a file of the folder in which this runs.
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(_ignore)
        try:
            for _ in range(self._substeps):
                self._drives.prepare(self._model, data)
                mujoco.mj_step(self._model, data)
        finally:
            mujoco.set_mju_user_warning(before)
        if any(data.warning[kind].number for kind in self._unstable):
            raise UnstableError(
                f"MuJoCo became unstable with {self.placement.target.name}: raise the engine's `substeps`, "
                "or the physics' rates."
            )
