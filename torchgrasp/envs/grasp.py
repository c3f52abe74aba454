"""GraspEnv: closed-loop 6-DoF grasping as a batched TorchRL environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from torchgrasp import keys
from torchgrasp.envs.scene import Scene, SceneSampler, StartPoses
from torchgrasp.errors import ConfigError, TorchgraspError
from torchgrasp.geometry import ACTION_BOUND, ACTION_SIZE, action_to_pose
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import Camera, RaycastCamera
from torchgrasp.sim.world import Physics
from torchgrasp.sim.worlds import Worlds

# Reference: lifted means at least 8 cm higher.
LIFTED = 0.08
_FALLEN = -0.10


class GraspEnv(EnvBase):
    """N worlds, each a Panda, a table and one object; the keys are those of `torchgrasp.keys`.

    An episode lasts `horizon` steps of 0.15 s. After the last the fingers close, the hand lifts, and
    the reward is 1 where the object rose by 8 cm, else 0. It also ends, unrewarded, when the object
    falls off the table. Both ends are terminal: nothing is bootstrapped.

    World i draws its episodes from (seed, first_world + i, episode number) and shares nothing with
    its neighbours, so that the same actions give the same episode whatever num_envs is.

    Args:
        num_envs: N; the batch size is [N].
        objects: what is grasped.
        camera: the wrist camera; 112 x 112 by default.
        horizon: T, steps of an episode (Sec. 6.4: 30).
        start: the distribution of object places and start poses.
        physics: masses, friction, rates.
        target_motion: how the target moves before it is touched; ``static`` so far.
        seed: of all randomness; `set_seed` changes it.
        first_world: number of the first world, so that several processes share out one set of worlds.
        device: of the tensors; physics runs on the CPU.

    Attributes:
        worlds: the physics, batched.

    Example:
        >>> from torchgrasp.objects import ProceduralObjects
        >>> env = GraspEnv(2, objects=ProceduralObjects("train", num_objects=1, num_grasps=100), horizon=3)
        >>> env.rollout(3)["next", "reward"].shape
        torch.Size([2, 3, 1])
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        objects: Sequence[GraspObject],
        camera: Camera | None = None,
        horizon: int = 30,
        start: StartPoses | None = None,
        physics: Physics | None = None,
        target_motion: Literal["static"] = "static",
        seed: int = 0,
        first_world: int = 0,
        device: torch.device | str = "cpu",
    ) -> None:
        for name, value in (("num_envs", num_envs), ("horizon", horizon)):
            if not isinstance(value, int) or value < 1:
                raise ConfigError(f"env.{name}={value} is out of range: give a whole number of at least 1.")
        if target_motion != "static":
            raise ConfigError(f"env.target_motion={target_motion!r} is unknown: give 'static'.")
        super().__init__(device=device, batch_size=torch.Size([num_envs]))
        self.horizon = horizon
        self.first_world = first_world
        self.target_motion = target_motion
        self._base_seed = seed
        self.worlds = Worlds(num_envs, physics=physics or Physics(), camera=camera or RaycastCamera())
        self._scenes = SceneSampler(objects, physics=self.worlds.physics, start=start or StartPoses())
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._episodes = np.full(num_envs, -1, dtype=np.int64)
        self._object_ids = np.zeros(num_envs, dtype=np.int64)
        self._over = np.ones(num_envs, dtype=bool)
        self._make_specs()

    @property
    def objects(self) -> Sequence[GraspObject]:
        """What is grasped; OBJECT_ID counts in it."""
        return self._scenes.objects

    def _make_specs(self) -> None:
        batch, device = self.batch_size, self.device
        cam = self.worlds.camera.intrinsics

        def real(*shape: int) -> Unbounded:
            return Unbounded(batch + shape, dtype=torch.float32, device=device)

        def count() -> Unbounded:
            return Unbounded(torch.Size((*batch, 1)), dtype=torch.int64, device=device)

        def flag(*shape: int) -> Binary:
            return Binary(shape=batch + shape, dtype=torch.bool, device=device)

        def share() -> Bounded:
            return Bounded(0.0, 1.0, shape=torch.Size((*batch, 1)), dtype=torch.float32, device=device)

        camera = {"depth": real(cam.height, cam.width), "mask": flag(cam.height, cam.width)}
        self.observation_spec = Composite(
            {
                "camera": Composite(camera, shape=batch, device=device),
                keys.T_BASE_EE: real(4, 4),
                keys.T_BASE_CAMERA: real(4, 4),
                keys.T_BASE_OBJECT: real(4, 4),
                keys.OBJECT_ID: count(),
                keys.WORLD: count(),
                keys.EPISODE: count(),
                keys.JOINTS: real(9),
                keys.JOINT_VELOCITIES: real(9),
                keys.TIME_LEFT: share(),
            },
            shape=batch,
            device=device,
        )
        bound = torch.tensor(ACTION_BOUND, device=device).expand(*batch, ACTION_SIZE)
        self.action_spec = Bounded(-bound, bound, shape=bound.shape, dtype=torch.float32, device=device)
        self.reward_spec = share()
        flags = {name: flag(1) for name in ("done", "terminated", "truncated")}
        self.done_spec = Composite(flags, shape=batch, device=device)

    @property
    def num_envs(self) -> int:
        """N."""
        return self.batch_size[0]

    @property
    def episodes_started(self) -> list[int]:
        """For each world the number of its current episode, -1 before the first."""
        return self._episodes.tolist()

    def start_episodes_at(self, numbers: Sequence[int]) -> None:
        """Let the next reset of world i begin its episode numbers[i]: how a run is resumed."""
        self._episodes[:] = np.asarray(numbers, dtype=np.int64) - 1
        self._over[:] = True

    def _set_seed(self, seed: int | None) -> None:
        self._base_seed = 0 if seed is None else seed
        self._episodes[:] = -1
        self._over[:] = True

    def _rows(self, tensordict: TensorDictBase | None, key: str) -> np.ndarray:
        """Indices of the worlds that a mask in the tensordict selects; all where there is none."""
        mask = None if tensordict is None else tensordict.get(key, None)
        if mask is None:
            return np.arange(self.num_envs)
        return np.flatnonzero(mask.reshape(self.num_envs, -1).any(-1).cpu().numpy())

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        for row in self._rows(tensordict, "_reset"):
            self._episodes[row] += 1
            scene = self.scene(int(row), int(self._episodes[row]))
            self.worlds.place(int(row), self.objects[scene.object_id], scene.T_base_object, scene.q)
            self._object_ids[row] = scene.object_id
            self._steps[row], self._over[row] = 0, False
        return self._observation().update(self._flags(np.zeros(self.num_envs, dtype=bool)))

    def scene(self, row: int, episode: int) -> Scene:
        """The scene with which world `row` begins its episode of that number."""
        return self._scenes.sample(self._base_seed, self.first_world + row, episode)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get(keys.ACTION).detach().to("cpu", torch.float64)
        if not bool(torch.isfinite(action).all()):
            raise TorchgraspError(
                "GraspEnv was given an action with NaN or infinity: look at the policy's output."
            )
        rows = self._rows(tensordict, "_step")
        rows = rows[~self._over[rows]]
        bound = torch.tensor(ACTION_BOUND, dtype=torch.float64)
        change = action_to_pose(action.clamp(-bound, bound)).numpy()
        self.worlds.drive_to_pose(self.worlds.T_base_ee @ change, rows.tolist())
        self._steps[rows] += 1
        out = self._observation()
        reward = self._finish(rows)
        out.set("reward", reward)
        return out.update(self._flags(self._over))

    def _finish(self, rows: np.ndarray) -> Tensor:
        """End the episodes that are due among `rows`; (N, 1) reward of this step."""
        heights = self.worlds.T_base_object[:, 2, 3]
        fallen = rows[heights[rows] < _FALLEN]
        last = rows[(self._steps[rows] >= self.horizon) & (heights[rows] >= _FALLEN)]
        reward = torch.zeros(self.num_envs, 1)
        if len(last):
            rise = self.worlds.close_and_lift(last.tolist())
            reward[last, 0] = torch.from_numpy((rise >= LIFTED).astype(np.float32))
        self._over[fallen] = self._over[last] = True
        return reward.to(self.device)

    def _observation(self) -> TensorDict:
        """Everything that can be seen, as fresh tensors that no later step writes to."""
        worlds = self.worlds
        pictures = worlds.observe()
        T_base_ee = worlds.T_base_ee
        arrays = {
            keys.T_BASE_EE: T_base_ee,
            keys.T_BASE_CAMERA: worlds.camera.pose(T_base_ee),
            keys.T_BASE_OBJECT: worlds.T_base_object,
            keys.JOINTS: worlds.joints,
            keys.JOINT_VELOCITIES: worlds.joint_velocities,
            keys.TIME_LEFT: (1.0 - self._steps / self.horizon)[:, None],
        }
        out = TensorDict({}, batch_size=self.batch_size, device=self.device)
        for channel, picture in pictures.items():
            out.set(("camera", channel), torch.from_numpy(picture))
        for key, array in arrays.items():
            out.set(key, torch.from_numpy(array.astype(np.float32)))
        out.set(keys.OBJECT_ID, torch.from_numpy(self._object_ids[:, None].copy()))
        out.set(keys.WORLD, torch.arange(self.num_envs)[:, None] + self.first_world)
        out.set(keys.EPISODE, torch.from_numpy(self._episodes[:, None].copy()))
        return out

    def _flags(self, over: np.ndarray) -> dict[str, Tensor]:
        done = torch.from_numpy(over[:, None].copy()).to(self.device)
        return {"done": done, "terminated": done.clone(), "truncated": torch.zeros_like(done)}
