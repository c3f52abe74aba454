"""GraspEnv: closed-loop 6-DoF grasping as a batched TorchRL environment."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from torchgrasp import keys
from torchgrasp.envs.motion import TargetMotion, make_target_motion
from torchgrasp.envs.scene import Scene, SceneSampler
from torchgrasp.envs.specs import SpecMaker
from torchgrasp.envs.starts import Start, StartPoses
from torchgrasp.envs.trigger import GRASP_TRIGGERS, GraspTrigger, is_between_fingers
from torchgrasp.errors import ConfigError, TorchgraspError, check_whole
from torchgrasp.objects.model import GraspObject
from torchgrasp.sim import Camera, Engine, EngineName, Physics, Placement, RaycastCamera, Worlds
from torchgrasp.sim.control import ActionSpaceName, make_action_space
from torchgrasp.sim.world import LIFTED

_FALLEN = -0.10


class GraspEnv(EnvBase):
    """N worlds, each a Panda, a table and one object; the keys are those of `torchgrasp.keys`.

    An episode lasts `horizon` steps of 0.15 s. After the last the fingers close, the hand lifts, and
    the reward is 1 where the object rose by 8 cm, else 0. It also ends, unrewarded, when the object
    falls off the table, and where the physics becomes unstable (`worlds.unstable`). All ends are terminal:
    nothing is bootstrapped.

    World i draws its episodes from (seed, first_world + i, episode number) and shares nothing with
    its neighbours, so that the same actions give the same episode whatever num_envs is.

    A policy may also propose actions: where it writes TRIED_ACTION (N, M, A), the step that ends an episode
    by its horizon tells their rewards in ("next", TRIED_REWARD), as `try_last_actions` does, before it takes
    ACTION. At all other steps those are NaN.

    Args:
        num_envs: N; the batch size is [N].
        objects: what is grasped.
        camera: the wrist camera; 112 x 112 by default.
        overhead: a second camera, usually one that stands still, or None.
        horizon: T, steps of an episode (Sec. 6.4: 30).
        start: the distribution of object places and start postures.
        physics: masses, friction, forces, rates; what has a range is drawn for each episode.
        engine: that the worlds move by: ``sapien``, ``mujoco`` (extra mujoco), or an `Engine`.
        target_motion: ``static``, ``jitter`` (Sec. 6.6), ``handover`` (6.7), ``mixed``, or a motion itself.
        action_space: ``ee_delta``, ``joint_delta`` or ``joint_velocity``.
        grasp_trigger: ``horizon``: the fingers close after the last step; ``between_fingers``: after
            the first at which the target fills half of the space between them, at the last otherwise.
        object_order: ``random`` or ``cycle``, see `SceneSampler`.
        seed: of all randomness; `set_seed` changes it. Drawn if None, so that two environments differ.
        first_world: number of the first world, so that several processes share out one set of worlds.
        device: of the tensors; physics runs on the CPU.

    Attributes:
        worlds: the physics, batched.
        actions: what an action means.

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
        overhead: Camera | None = None,
        horizon: int = 30,
        start: Start | None = None,
        physics: Physics | None = None,
        engine: Engine | EngineName = "sapien",
        target_motion: TargetMotion | Literal["static", "jitter", "handover", "mixed"] = "static",
        action_space: ActionSpaceName = "ee_delta",
        grasp_trigger: GraspTrigger = "horizon",
        object_order: Literal["random", "cycle"] = "random",
        seed: int | None = None,
        first_world: int = 0,
        device: torch.device | str = "cpu",
    ) -> None:
        check_whole("num_envs", num_envs, 1)
        check_whole("horizon", horizon, 1)
        if seed is not None:
            check_whole("seed", seed, 0)
        if grasp_trigger not in GRASP_TRIGGERS:
            raise ConfigError(
                f"grasp_trigger={grasp_trigger!r} is unknown: give {' or '.join(GRASP_TRIGGERS)}."
            )
        super().__init__(device=device, batch_size=torch.Size([num_envs]))
        self.horizon, self.first_world, self.grasp_trigger = horizon, first_world, grasp_trigger
        self.cameras: dict[str, Camera] = {"camera": camera or RaycastCamera()}
        if overhead is not None:
            self.cameras["overhead"] = overhead
        self.worlds = Worlds(num_envs, engine=engine)
        physics = physics or Physics()
        self.actions = make_action_space(action_space, control_period=physics.control_period)
        self._base_seed = _choose_seed(seed)
        self._scenes = SceneSampler(
            objects,
            physics=physics,
            start=start or StartPoses(),
            motion=make_target_motion(target_motion),
            object_order=object_order,
        )
        self._playing: list[Scene | None] = [None] * num_envs
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._episodes = np.full(num_envs, -1, dtype=np.int64)
        self._over = np.ones(num_envs, dtype=bool)
        make = SpecMaker(self.batch_size, self.device)
        self.observation_spec = make.observation(self.cameras)
        self.action_spec = make.action(self.actions.bound)
        self.reward_spec, self.done_spec = make.real(1), make.done()

    @property
    def objects(self) -> Sequence[GraspObject]:
        """What is grasped; OBJECT_ID counts in it."""
        return self._scenes.objects

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

    def scene(self, row: int, episode: int) -> Scene:
        """The scene with which world `row` begins its episode of that number."""
        return self._scenes.sample(self._base_seed, self.first_world + row, episode)

    def _set_seed(self, seed: int | None) -> None:
        self._base_seed = _choose_seed(seed)
        self._episodes[:] = -1
        self._over[:] = True

    def _rows(self, tensordict: TensorDictBase | None, key: str) -> np.ndarray:
        """Indices of the worlds that a mask in the tensordict selects; all where there is none."""
        mask = None if tensordict is None else tensordict.get(key, None)
        if mask is None:
            return np.arange(self.num_envs)
        return np.flatnonzero(mask.reshape(self.num_envs, -1).any(-1).cpu().numpy())

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        for row in self._rows(tensordict, "_reset").tolist():
            self._episodes[row] += 1
            scene = self._playing[row] = self.scene(row, int(self._episodes[row]))
            self.worlds.place(
                row,
                Placement(
                    self.objects[scene.object_id],
                    scene.T_base_object,
                    scene.q,
                    scene.physics,
                    held=scene.held,
                    appearance=scene.appearance,
                ),
            )
            self._steps[row], self._over[row] = 0, False
        return self._report(np.zeros(self.num_envs, dtype=bool))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = _read_finite(tensordict.get(keys.ACTION))
        rows = self._rows(tensordict, "_step")
        rows = rows[~self._over[rows]]
        tried = self._try_proposed(tensordict.get(keys.TRIED_ACTION, None), rows)
        self._move_targets(rows)
        bound = np.asarray(self.actions.bound)
        q = self.worlds.joints[rows, :7]
        action = np.clip(action[rows], -bound, bound)
        self.worlds.drive(self.actions.posture(q, self.worlds.T_base_ee[rows], action), rows.tolist())
        self._steps[rows] += 1
        seen = self._observe()
        reward = self._finish(rows)
        return self._report(self._over, seen | tried, reward)

    def _try_proposed(self, actions: Tensor | None, rows: np.ndarray) -> dict:
        """Rewards (N, M, 1) of proposed actions (N, M, A), where an episode of `rows` is at its last step."""
        if actions is None:
            return {}
        proposed = self._check_tried(actions)
        reward = np.full((*proposed.shape[:2], 1), np.nan, dtype=np.float32)
        last = rows[self._steps[rows] == self.horizon - 1]
        reward[last, :, 0] = self._try_last(proposed, last)[last]
        return {keys.TRIED_REWARD: torch.from_numpy(reward)}

    def _move_targets(self, rows: np.ndarray) -> None:
        """Move the targets that are due, but none into the hand."""
        T_base_object, T_base_ee = self.worlds.T_base_object, self.worlds.T_base_ee
        for row in rows.tolist():
            after = self._find_move(row, T_base_object[row], T_base_ee[row])
            if after is not None:
                self.worlds.move_target(row, after)

    def _find_move(self, row: int, T_base_object: np.ndarray, T_base_ee: np.ndarray) -> np.ndarray | None:
        """(4, 4) pose that the target of world `row` moves to in this step; None where it stays."""
        scene = self._playing[row]
        assert scene is not None
        return scene.find_move(int(self._steps[row]), self.objects[scene.object_id], T_base_object, T_base_ee)

    def try_last_actions(self, actions: Tensor) -> Tensor:
        """Whether each of the actions (N, M, A) would lift the target if it were the last one: (N, M) bool.

        Each is taken in a copy of its world as it is now, which then closes its fingers and lifts. The worlds
        themselves stay as they are, so that an episode goes on as if nothing had been tried. A copy begins at
        rest, where the arm may still be in motion: of an action that only just holds the outcome may differ.

        The values of a critic's last step are such outcomes, and one state gives as many as are asked for
        (vine rollouts: Schulman et al. 2015, arXiv 1502.05477, Sec. 5.2). Nothing is lifted where an episode
        is over.

        Example:
            >>> from torchgrasp.objects import ProceduralObjects
            >>> env = GraspEnv(1, objects=ProceduralObjects("train", num_objects=1, num_grasps=100), seed=0)
            >>> _ = env.reset()
            >>> env.try_last_actions(torch.zeros(1, 2, 6))
            tensor([[False, False]])
        """
        if None in self._playing:
            raise TorchgraspError(
                "GraspEnv has no episode in which actions could be tried: call reset first."
            )
        lifted = self._try_last(self._check_tried(actions), np.flatnonzero(~self._over))
        return torch.from_numpy(lifted).to(self.device)

    def _check_tried(self, actions: Tensor) -> np.ndarray:
        """Actions (N, M, A) within their bounds."""
        count, size = self.num_envs, self.actions.size
        if actions.ndim != 3 or (actions.shape[0], actions.shape[2]) != (count, size):
            raise ConfigError(
                f"actions of shape {tuple(actions.shape)}: give (N, M, A), here ({count}, M, {size})."
            )
        bound = np.asarray(self.actions.bound)
        return np.clip(_read_finite(actions), -bound, bound)

    def _try_last(self, actions: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """(N, M) bool: which of the actions (N, M, A) lift, in the worlds `rows`."""
        T_base_object, T_base_ee = self.worlds.T_base_object, self.worlds.T_base_ee
        q, repeats = self.worlds.joints[:, :7], actions.shape[1]
        lifted = np.zeros(actions.shape[:2], dtype=bool)
        for row in rows.tolist():
            after = self._find_move(row, T_base_object[row], T_base_ee[row])
            start, hand = (np.repeat(each[row][None], repeats, axis=0) for each in (q, T_base_ee))
            postures = self.actions.posture(start, hand, actions[row])
            lifted[row] = self.worlds.try_last(row, postures, T_base_object=after) >= LIFTED
        return lifted

    def _finish(self, rows: np.ndarray) -> np.ndarray:
        """End the episodes that are due among `rows`; (N, 1) reward of this step."""
        T_base_object, T_base_ee = self.worlds.T_base_object, self.worlds.T_base_ee
        heights = T_base_object[rows, 2, 3]
        ended = (heights < _FALLEN) | self.worlds.unstable[rows]
        lost, due = rows[ended], rows[~ended]
        last = [row for row in due.tolist() if self._is_last(row, T_base_object[row], T_base_ee[row])]
        reward = np.zeros((self.num_envs, 1), dtype=np.float32)
        if last:
            reward[last, 0] = self.worlds.close_and_lift(last) >= LIFTED
        self._over[lost] = self._over[last] = True
        return reward

    def _is_last(self, row: int, T_base_object: np.ndarray, T_base_ee: np.ndarray) -> bool:
        scene = self._playing[row]
        assert scene is not None
        if self._steps[row] >= self.horizon:
            return True
        if self.grasp_trigger == "horizon":
            return False
        return is_between_fingers(self.objects[scene.object_id], T_base_object, T_base_ee)

    def _observe(self) -> dict:
        """Everything that can be seen, as fresh tensors that no later step writes to."""
        worlds, n = self.worlds, self.num_envs
        T_base_ee = worlds.T_base_ee
        reals = {
            keys.T_BASE_EE: T_base_ee,
            keys.T_BASE_OBJECT: worlds.T_base_object,
            keys.JOINTS: worlds.joints,
            keys.JOINT_VELOCITIES: worlds.joint_velocities,
            keys.TIME_LEFT: (1.0 - self._steps / self.horizon)[:, None],
        }
        out: dict = {}
        for name, camera in self.cameras.items():
            pictures = worlds.observe(camera)
            out[name] = {channel: torch.from_numpy(picture) for channel, picture in pictures.items()}
            reals[f"T_base_{name}"] = camera.pose(T_base_ee)
        for key, array in reals.items():
            out[key] = torch.from_numpy(array.astype(np.float32))
        playing = [[-1 if scene is None else scene.object_id] for scene in self._playing]
        out[keys.OBJECT_ID] = torch.tensor(playing)
        out[keys.WORLD] = torch.arange(n)[:, None] + self.first_world
        out[keys.EPISODE] = torch.from_numpy(self._episodes[:, None].copy())
        return out

    def _report(
        self, over: np.ndarray, seen: dict | None = None, reward: np.ndarray | None = None
    ) -> TensorDict:
        """One tensordict of what was seen, the reward of a step, and the flags."""
        entries = self._observe() if seen is None else seen
        if reward is not None:
            entries["reward"] = torch.from_numpy(reward)
        done: Tensor = torch.from_numpy(over[:, None].copy())
        entries |= {"done": done, "terminated": done.clone(), "truncated": torch.zeros_like(done)}
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)


def _read_finite(action: Tensor) -> np.ndarray:
    """Actions (*) as float64."""
    numbers = action.detach().to("cpu", torch.float64).numpy()
    if not np.isfinite(numbers).all():
        raise TorchgraspError(
            "GraspEnv was given an action with NaN or infinity: look at the policy's output."
        )
    return numbers


def _choose_seed(seed: int | None) -> int:
    # Not torch's generator, which begins alike in every process.
    return secrets.randbits(63) if seed is None else seed
