"""A rehearsal: an FR3 that speaks libfranka's protocol on this machine, a table and an object to grasp."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
import trimesh

from torchgrasp.deploy.depth_camera import Picture
from torchgrasp.deploy.rehearsal_scene import OBJECT_JOINT, Contact, build_scene, damp_object
from torchgrasp.errors import ConfigError, MissingPackageError, ObjectError
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim.camera import Camera, View
from torchgrasp.sim.kinematics import forward_kinematics
from torchgrasp.sim.physics import Physics

_OPEN_WIDTH = 0.08
_HOSTS = tuple(f"127.0.0.{last}" for last in range(1, 255))
# Stiff enough that a thin object meets the force that the gripper is asked for, N/m of a finger.
_FINGER_STIFFNESS = 4000.0
# The drives' damping: franky-sim's own, ten times less than this stiffness, lags 0.1 s behind each command.
_STIFFNESS = (4500.0, 4500.0, 3500.0, 3500.0, 2000.0, 2000.0, 2000.0)
_DAMPING = (180.0, 180.0, 140.0, 140.0, 50.0, 50.0, 50.0)
_FILTER = 0.02  # seconds over which torques are averaged for the reflex, as a robot's estimates are


@dataclass(frozen=True)
class Snapshot:
    """What is where at one millisecond.

    Attributes:
        time: seconds since the start.
        joints: (9,) arm angles and finger positions.
        T_base_object: (4, 4) pose of the object.
    """

    time: float
    joints: np.ndarray
    T_base_object: np.ndarray


class Rehearsal:
    """franky-sim with a table and an object: a Franka on the loopback, to be used with `with`.

    It runs in real time in a thread of its own, or slower where the machine is busy; `clock` is its time.

    Args:
        target: the object to grasp.
        T_base_object: (4, 4) where it rests.
        q: (7,) arm angles at the start, rad.
        physics: mass, frictions and damping of the object.
        contact: how bodies touch.
        reflex_torque: Nm that contact may put on a joint of the arm before the robot stops by itself, as a
            Franka does; inf for an arm that never does.
        hosts: addresses of the loopback, of which the first with free ports is taken.

    Attributes:
        host: address to connect to.

    Raises:
        MissingPackageError: without franky-sim.
        ConfigError: at the start, where the ports of all addresses are taken.
        ObjectError: at the start, where MuJoCo refuses the object.
    """

    def __init__(
        self,
        target: GraspObject,
        T_base_object: np.ndarray,
        q: np.ndarray,
        *,
        physics: Physics | None = None,
        contact: Contact | None = None,
        reflex_torque: float = 40.0,
        hosts: Sequence[str] = _HOSTS,
    ) -> None:
        franky_sim = _load_franky_sim()
        self.target, self.physics = target, physics or Physics()
        self._reflex_torque, self._torques = reflex_torque, np.zeros(7)
        self._simulator = franky_sim.mujoco_simulator.MujocoSimulator(enable_visualization=False)
        self._robot = self._simulator.add_robot(
            initial_q=tuple(np.asarray(q, dtype=float).tolist()),
            initial_hand_width=_OPEN_WIDTH,
            kp=_STIFFNESS,
            kv=_DAMPING,
        )
        self._robot._kp_hand = np.full(2, _FINGER_STIFFNESS)
        build_scene(self._simulator, target, T_base_object, self.physics, contact or Contact())
        self._server = franky_sim.SimulationServer(self._simulator, tuple(hosts))
        self._watchers: list[Callable[[Snapshot], None]] = []
        self._told_to_stop = threading.Event()

    def __enter__(self) -> Rehearsal:
        self._simulator.init()
        try:
            self._begin()
        except BaseException:
            self._clean_up()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._clean_up()

    def _begin(self) -> None:
        try:
            self._server.init()
        except OSError as error:
            raise ConfigError(
                f"hosts: none has both ports of a robot free ({error}): end what listens there, or give "
                "others."
            ) from error
        except ValueError as error:
            told = str(error).strip().splitlines()[0]
            raise ObjectError(
                f"{self.target.name} cannot be rehearsed: MuJoCo refuses it ({told})."
            ) from error
        model = self._simulator.model
        damp_object(model, self.target, self.physics)
        self._object = int(model.joint(OBJECT_JOINT).qposadr[0])
        self._now = self._start = self._take_snapshot()
        self._simulator.register_post_step_callback(self._after_step)
        self._server.run_async()

    def _clean_up(self) -> None:
        self._server.cleanup()
        self._simulator.cleanup()

    @property
    def host(self) -> str:
        """Address of the robot."""
        return str(self._robot.hostname)

    @property
    def now(self) -> Snapshot:
        """The scene as it is."""
        return self._now

    def clock(self) -> float:
        """Seconds of the simulation."""
        return self._now.time

    @property
    def risen(self) -> float:
        """Metres that the object is above where it began."""
        return float(self._now.T_base_object[2, 3] - self._start.T_base_object[2, 3])

    @property
    def model(self) -> Any:
        """MuJoCo's model of the scene."""
        return self._simulator.model

    def to_qpos(self, snapshot: Snapshot) -> np.ndarray:
        """MuJoCo's coordinates of a snapshot."""
        qpos = np.zeros(self.model.nq)
        qpos[[*self._robot._qpos_addrs, *self._robot._finger_qpos_addrs]] = snapshot.joints
        turn = trimesh.transformations.quaternion_from_matrix(snapshot.T_base_object)  # wxyz
        qpos[self._object : self._object + 7] = (*snapshot.T_base_object[:3, 3], *turn)
        return qpos

    def watch(self, watcher: Callable[[Snapshot], None]) -> None:
        """Have each millisecond told, in the simulation's thread: what is slow there slows the robot."""
        self._watchers.append(watcher)

    def abort_motion(self) -> None:
        """Have the robot stop by a reflex: at once, or as soon as it moves."""
        self._told_to_stop.set()

    def _after_step(self, _: Any) -> None:
        self._now = self._take_snapshot()
        data, robot = self._simulator.data, self._robot
        torques = data.qfrc_constraint[robot._dof_addrs]
        self._torques += 1e-3 / _FILTER * (torques - self._torques)
        motion = self._robot.server.current_motion_id
        if motion and (self._told_to_stop.is_set() or np.abs(self._torques).max() > self._reflex_torque):
            self._told_to_stop.clear()
            self._stop_by_reflex(motion)
        for watcher in self._watchers:
            watcher(self._now)

    def _stop_by_reflex(self, motion: int) -> None:
        """End the motion under way as a robot does that has met something: franky-sim has no reflexes."""
        from franky_sim.franka_robot_protocol import MoveStatus, RobotCommand
        from franky_sim.franka_server import BaseCommand

        server = self._robot.server
        self._torques[:] = 0.0
        server.stop_motion(send_preemption_signal=False)
        BaseCommand.send_response(server._tcp_socket, RobotCommand.kMove, motion, MoveStatus.kReflexAborted)
        server.reset_current_motion_id()

    def _take_snapshot(self) -> Snapshot:
        data, robot = self._simulator.data, self._robot
        joints = np.array(data.qpos[[*robot._qpos_addrs, *robot._finger_qpos_addrs]])
        place = data.qpos[self._object : self._object + 7]
        pose = trimesh.transformations.quaternion_matrix(place[3:])
        pose[:3, 3] = place[:3]
        return Snapshot(float(data.time), joints, pose)


class RehearsalCamera:
    """A camera of ours that looks at a rehearsal: a DepthCamera by ray casting.

    Args:
        rehearsal: what is looked at.
        camera: of `torchgrasp.sim`.
    """

    def __init__(self, rehearsal: Rehearsal, camera: Camera) -> None:
        self._rehearsal, self._camera = rehearsal, camera

    def read(self) -> Picture:
        """See `DepthCamera.read`; the time is the rehearsal's."""
        now = self._rehearsal.now
        hand = forward_kinematics(now.joints[None, :7])[0]
        seen = self._camera.observe(View(self._rehearsal.target, now.T_base_object, now.joints, hand))
        return Picture(seen["depth"], seen["mask"], now.time)


def _load_franky_sim() -> Any:
    try:
        import franky_sim
        import franky_sim.mujoco_simulator
    except ImportError as error:
        raise MissingPackageError(
            f'A rehearsal needs franky-sim of the extra dev ({error}): pip install "torchgrasp[dev]".'
        ) from error
    return franky_sim
