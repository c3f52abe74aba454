"""HindsightGoal: where an episode has grasped becomes the goal of its steps (Algorithm 1, Sec. 6.1)."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from torchgrasp import keys
from torchgrasp.episodes import find_outcomes
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import NO_GOAL, invert_pose, pose_to_goal
from torchgrasp.transforms.base import find_container


class HindsightGoal(Transform):
    """Writes goal_t = T_t^-1 T_reached into the steps of successful episodes (Sec. 6.1).

    T_reached is the pose of the hand when it closes: ("next", T_BASE_EE) of the episode's last step,
    which GraspEnv reads before it closes and lifts. An episode succeeded if its last reward is above
    0.5. Steps of other episodes, and of those that the rollout cuts off before their end, have no
    goal afterwards. Rewards stay as they are, unlike in HER; Eq. (5) is
    ``GraspTD3BCLoss(hindsight=True)``.

    On a bare tensordict (*, T), time last, the call writes GOAL (*, T, 7) and HAS_GOAL (*, T, 1),
    and both in "next"; labels only with `imitate`. As the `transform` of a replay buffer it does so
    when trajectories are extended, and drops the poses; sampled batches, which have none, it leaves
    as they are. In an environment, which does not know how an episode ends, it changes nothing.

    Args:
        keep: leave goals that are known already, such as the expert's, where has_goal is true, and
            with `imitate` labels where has_expert is. By default what is written anew takes their
            place: of unknown objects there are none.
        imitate: also make the actions of successful episodes labels of imitation, EXPERT_ACTION
            (*, T, 6) and HAS_EXPERT (*, T, 1), but for steps that a disturbance moved (perturbed).
            Self-imitation after Oh et al. 2018, without their values; not in the paper.

    Example:
        >>> from tensordict import TensorDict
        >>> poses = torch.eye(4).repeat(3, 1, 1)
        >>> poses[:, 2, 3] = torch.tensor([0.0, 0.1, 0.3])  # the hand moves along its z axis
        >>> ends = {"reward": torch.tensor([[0.0], [1.0]]), "done": torch.tensor([[False], [True]])}
        >>> steps = TensorDict({"T_base_ee": poses[:2], "next": {"T_base_ee": poses[1:], **ends}}, [2])
        >>> HindsightGoal()(steps)["goal"][:, 2]
        tensor([0.3000, 0.2000])
    """

    def __init__(self, *, keep: bool = False, imitate: bool = False) -> None:
        super().__init__()
        self._keep, self._imitate = keep, imitate

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the goals of trajectories (*, T); a tensordict without poses stays as it is."""
        if tensordict.get(keys.T_BASE_EE, None) is None:
            return tensordict
        return self._relabel(tensordict)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if find_container(self) is not None:
            return tensordict
        relabelled = self._relabel(tensordict.copy())
        return relabelled.exclude(keys.T_BASE_EE, ("next", keys.T_BASE_EE))

    def _relabel(self, steps: TensorDictBase) -> TensorDictBase:
        names = [keys.T_BASE_EE, ("next", keys.T_BASE_EE), ("next", "reward"), ("next", "done")]
        names += [keys.ACTION] * self._imitate
        missing = [name for name in names if steps.get(name, None) is None]
        if missing:
            raise ConfigError(f"HindsightGoal needs {missing} of each step: keep them with the trajectories.")
        end, success = find_outcomes(steps)
        following = steps.get("next").copy()
        after = following[keys.T_BASE_EE]
        T_base_reached = after.gather(-3, end[..., None, None].expand(after.shape))
        # Of actions that were only tried nobody knows where they led.
        success = success & T_base_reached.isfinite().all(-1).all(-1)
        for states in (steps, following):
            self._write(states, T_base_reached, success)
        if self._imitate:
            self._write_labels(steps, success)
        return steps.set("next", following)

    def _write(self, states: TensorDictBase, T_base_reached: Tensor, success: Tensor) -> None:
        """Set the goals of the `states` (*, T) where `success` (*, T) holds."""
        goal = pose_to_goal(invert_pose(states[keys.T_BASE_EE]) @ T_base_reached)
        has_goal = success[..., None]
        goal = torch.where(has_goal, goal, goal.new_tensor(NO_GOAL))
        self._set(states, (keys.GOAL, keys.HAS_GOAL), goal, has_goal)

    def _write_labels(self, steps: TensorDictBase, success: Tensor) -> None:
        """Make the actions of the `steps` (*, T) labels where `success` (*, T) holds."""
        has_expert = success[..., None]
        if (perturbed := steps.get(keys.PERTURBED, None)) is not None:
            has_expert = has_expert & ~perturbed
        self._set(steps, (keys.EXPERT_ACTION, keys.HAS_EXPERT), steps[keys.ACTION].clone(), has_expert)

    def _set(self, states: TensorDictBase, names: tuple[str, str], value: Tensor, present: Tensor) -> None:
        """Set a value (*, T, n) and where it is present (*, T, 1); what was known stays with `keep`."""
        old, known = (states.get(key, None) for key in names)
        if self._keep and old is not None and known is not None:
            value, present = torch.where(known, old, value), known | present
        states.set(names[0], value).set(names[1], present)
