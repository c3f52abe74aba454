"""CompactTransitions: trajectories to rows of some 6 kB, and sampled rows back to transitions."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from torchgrasp import keys
from torchgrasp.data.episodes import get_mask, label_episode_success
from torchgrasp.data.sampler import SOURCE, STUB
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_SIZE, GOAL_SIZE, gripper_control_points

_NO_GOAL = (0.0,) * (GOAL_SIZE - 1) + (1.0,)
_FLAGS = (keys.HAS_EXPERT, keys.HAS_GOAL, keys.PERTURBED)
_OUTCOMES = ("reward", "terminated", "done")
_NUM_GRIPPER_POINTS = len(gripper_control_points())


class CompactTransitions(Transform):
    """Buffer transform: stores each state once, points as float16, and rebuilds transitions.

    `inv` (on extend) takes a tensordict (*, T) from a collector or `rollout`, time last, and gives
    rows in order of time. A state whose successor is not the next row (the rollout was cut there,
    or the episode was truncated) is followed by a stub: a row that holds the last observation and
    is never drawn. `forward` (on sample) takes rows whose ("next", points) the storage has read
    from the following row (`MixtureStorage(next_keys=codec.observation_keys)`). On rows that
    terminated, next observations are those of the row itself: values there are masked.

    The gripper's six points end the cloud, equal in every state (X_g of Eq. (2)), and flags follow
    from the place, so that neither is stored. Labels that the data lack are stored as absent.

    Args:
        points_key: the cloud, (*, T, N + 6, 4) in metres, ee frame; flag last.
        state_keys: further observations, with next values.
        extra_keys: further keys to keep as they are, without next values.
        gripper_points: False for clouds without gripper points and flags: all of (*, T, N, C) is stored.
    """

    def __init__(
        self,
        *,
        points_key: NestedKey = keys.POINTS,
        state_keys: Sequence[NestedKey] = (keys.TIME_LEFT,),
        extra_keys: Sequence[NestedKey] = (),
        gripper_points: bool = True,
    ) -> None:
        super().__init__()
        self._points_key = points_key
        self.observation_keys: tuple[NestedKey, ...] = (points_key, *state_keys)
        self._extra_keys = tuple(extra_keys)
        self.gripper_points = gripper_points

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.encode(tensordict)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Rows (*) with ("next", observations) to transitions (*)."""
        return self.decode(tensordict)

    def encode(self, trajectories: TensorDictBase) -> TensorDict:
        """Trajectories (*, T) to rows (R), each trajectory in order of time, stubs included."""
        steps = trajectories.reshape(-1, trajectories.shape[-1])
        valid, linked = _find_links(steps)
        terminated = steps["next", "terminated"].squeeze(-1)
        needs_stub = valid & ~terminated & ~linked
        flat = steps.reshape(-1)
        step, stub = _order_rows(valid.reshape(-1), needs_stub.reshape(-1))
        rows = TensorDict({}, step.shape)
        for key in self.observation_keys:
            rows[key] = self._encode(key, flat[key], step)
            if bool(stub.any()):
                rows[key][stub] = self._encode(key, flat["next"][key], step[stub])
        for key, value in self._labels(steps).items():
            rows[key] = value.reshape(steps.numel(), -1)[step]
        for key in self._extra_keys:
            rows[key] = flat[key][step]
        return rows.set(STUB, stub.unsqueeze(-1))

    def _encode(self, key: NestedKey, values: Tensor, step: Tensor) -> Tensor:
        if key != self._points_key:
            return values[step]
        if not self.gripper_points:
            return values[step].half()
        self._check_points(values, step)
        return values[:, :-_NUM_GRIPPER_POINTS, :3][step].half()

    def _check_points(self, points: Tensor, step: Tensor) -> None:
        tail = points[:, -_NUM_GRIPPER_POINTS:, :3][step]
        expected = gripper_control_points(device=points.device).expand_as(tail)
        if points.shape[-1] != 4 or not torch.allclose(tail, expected, atol=1e-4):
            raise ConfigError(
                f"{self._points_key!r} of shape {tuple(points.shape)} does not end with the gripper's "
                f"{_NUM_GRIPPER_POINTS} points and a flag channel: put AppendGripperPoints after every "
                "transform that moves points, or build CompactTransitions(gripper_points=False)."
            )

    def _labels(self, steps: TensorDictBase) -> dict[NestedKey, Tensor]:
        shape = steps.shape
        labels: dict[NestedKey, Tensor] = {keys.ACTION: steps[keys.ACTION]}
        for key, default in default_labels().items():
            labels[key] = _get_or(steps, key, default.expand(*shape, *default.shape))
        for key in _OUTCOMES:
            labels[key] = steps["next", key]
        if steps.get(keys.EPISODE_SUCCESS, None) is None:
            steps = label_episode_success(steps.copy())
        labels[keys.EPISODE_SUCCESS] = steps[keys.EPISODE_SUCCESS]
        labels[SOURCE] = _get_or(steps, SOURCE, torch.zeros(*shape, 1, dtype=torch.int64))
        return labels

    def decode(self, rows: TensorDictBase) -> TensorDictBase:
        """Rows (*), with ("next", observations) or without, to float32 clouds and TorchRL's keys."""
        batch = rows.exclude(STUB, *_OUTCOMES)
        batch[self._points_key] = self._decode(rows[self._points_key])
        following = rows.get("next", TensorDict({}, rows.shape)).copy()
        next_points = following.get(self._points_key, None)
        if next_points is not None:
            following[self._points_key] = self._decode(next_points)
        for key in _OUTCOMES:
            following[key] = rows[key]
        return batch.set("next", following)

    def _decode(self, points: Tensor) -> Tensor:
        if not self.gripper_points:
            return points.float()
        *batch, num_points, _ = points.shape
        cloud = torch.zeros(*batch, num_points + _NUM_GRIPPER_POINTS, 4, device=points.device)
        cloud[..., :num_points, :3] = points
        cloud[..., num_points:, :3] = gripper_control_points(device=points.device)
        cloud[..., num_points:, 3] = 1.0
        return cloud


def default_labels() -> dict[NestedKey, Tensor]:
    """Each label of a row, of its shape and type, as it is stored where the data lack it."""
    labels: dict[NestedKey, Tensor] = {keys.EXPERT_ACTION: torch.zeros(ACTION_SIZE)}
    labels[keys.GOAL] = torch.tensor(_NO_GOAL)
    return labels | {key: torch.zeros(1, dtype=torch.bool) for key in _FLAGS}


def _get_or(steps: TensorDictBase, key: NestedKey, default: Tensor) -> Tensor:
    value = steps.get(key, None)
    return default.to(steps["next", "done"].device) if value is None else value


def _find_links(steps: TensorDictBase) -> tuple[Tensor, Tensor]:
    """(B, T) bool twice: which steps are real, and whose next state is the state of the step after."""
    done = steps["next", "done"].squeeze(-1)
    valid = get_mask(steps)
    same = ~done[:, :-1] & valid[:, :-1] & valid[:, 1:]
    for key in (("collector", "traj_ids"), "traj_ids", keys.EPISODE, SOURCE):
        number = steps.get(key, None)
        if number is not None:
            number = number.reshape(done.shape)
            same = same & (number[:, 1:] == number[:, :-1])
    return valid, torch.cat((same, torch.zeros_like(done[:, :1])), dim=1)


def _order_rows(valid: Tensor, needs_stub: Tensor) -> tuple[Tensor, Tensor]:
    """The step (R) that each row is made of, in order of time, and whether (R) the row is its stub."""
    step = torch.cat((valid.nonzero().squeeze(-1), needs_stub.nonzero().squeeze(-1)))
    stub = torch.arange(step.numel(), device=step.device) >= valid.sum()
    order = torch.argsort(2 * step + stub)
    return step[order], stub[order]
