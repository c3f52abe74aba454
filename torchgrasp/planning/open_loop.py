"""OpenLoopPolicy: plan once from the object's pose, then carry the plan out without looking again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.objects.model import GraspObject
from torchgrasp.planning.plan import Plan, PlanStatus
from torchgrasp.planning.planner import Planner
from torchgrasp.planning.pose_noise import PoseNoise
from torchgrasp.planning.trajectory_planner import TrajectoryPlanner
from torchgrasp.planning.world_states import STATE_KEYS, WorldStates
from torchgrasp.randomness import MomentGenerators
from torchgrasp.sim.control import ActionSpace, EeDelta
from torchgrasp.sim.kinematics import Array


@dataclass
class _Execution:
    """The plan that is carried out in one world, and for which moment it was made."""

    episode: tuple[int, int]
    T_base_object: Array
    planned_at: int
    plan: Plan
    steps_left: int

    def goes_on(self, episode: tuple[int, int], T_base_object: Array, steps_left: int) -> bool:
        """Whether this is the same episode, at the moment of the plan or later."""
        if self.episode != episode or steps_left > self.steps_left:
            return False
        # The first state of another seed's episode has the same numbers, but another object pose.
        return steps_left < self.planned_at or np.array_equal(T_base_object, self.T_base_object)


class OpenLoopPolicy(TensorDictModuleBase):
    """Carries out one planned trajectory an episode ("Planning" of Sec. 6.7, Table 6).

    At the first state of an episode the way to a grasp is planned from the object's pose as perceived.
    From then on the object is not looked at: the action of step k leads the hand from where it is, which
    the arm's own joints tell, to the planned pose k + 1, and after the plan's end to its last pose.
    Without a plan the arm holds still and PLAN_STATUS tells why.

    Worlds are told apart by WORLD, and a new episode by EPISODE or by a clock that went back. First asked
    in the middle of an episode, the policy plans then, over the steps that are left.

    Args:
        objects: the environment's objects, which OBJECT_ID counts in.
        horizon: the environment's, T.
        planner: of the trajectory; by default a `TrajectoryPlanner` that arrives with the plan's last step.
        steps: control steps of the plan (Sec. 6.7: 25).
        action_space: the environment's.
        pose_noise: error of the perceived pose, one draw an episode; None perceives perfectly.
        seed: of the draws.

    Example:
        >>> from torchgrasp.envs import GraspEnv
        >>> from torchgrasp.objects import ProceduralObjects
        >>> objects = ProceduralObjects("train", num_objects=1, num_grasps=100)
        >>> env = GraspEnv(2, objects=objects, horizon=30, seed=0)
        >>> OpenLoopPolicy(objects, horizon=30)(env.reset())["action"].shape
        torch.Size([2, 6])
    """

    def __init__(
        self,
        objects: Sequence[GraspObject],
        *,
        horizon: int,
        planner: Planner | None = None,
        steps: int = 25,
        action_space: ActionSpace | None = None,
        pose_noise: PoseNoise | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if isinstance(steps, bool) or not isinstance(steps, int) or not 1 <= steps <= horizon:
            raise ConfigError(
                f"steps={steps}: give a whole number from 1 to horizon={horizon}, the steps of an episode."
            )
        if planner is not None and not planner.gives_path:
            raise ConfigError("planner has no path to carry out: give it prove=True.")
        self.in_keys = list(STATE_KEYS)
        self.out_keys = [keys.ACTION, keys.PLAN_STATUS]
        self.objects, self.horizon, self.steps = objects, horizon, steps
        self.planner = planner or TrajectoryPlanner(arrive=1.0)
        self.actions = action_space or EeDelta()
        self.pose_noise = pose_noise
        self._generators = MomentGenerators(seed, purpose="OpenLoopPolicy", per_episode=True)
        self._executions: dict[int, _Execution] = {}

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ACTION (*, A) and PLAN_STATUS (*, 1)."""
        batch, device = tensordict.batch_size, tensordict.device
        states = WorldStates.read(tensordict, self.horizon)
        target, status = states.T_base_ee.copy(), []
        for row in range(len(states.worlds)):
            execution = self._execution(tensordict, states, row)
            status.append([execution.plan.status.number])
            if execution.plan.ok:
                path = execution.plan.T_base_ee
                age = execution.planned_at - execution.steps_left
                target[row] = path[min(age + 1, len(path) - 1)]
        number = torch.tensor(status)
        action = torch.from_numpy(self.actions.action_towards(states.q, states.T_base_ee, target)).float()
        action *= number == PlanStatus.OK.number  # inverse kinematics leaves a residue where nothing moves
        tensordict.set(keys.ACTION, action.reshape(*batch, self.actions.size).to(device))
        return tensordict.set(keys.PLAN_STATUS, number.reshape(*batch, 1).to(device))

    def _execution(self, tensordict: TensorDictBase, states: WorldStates, row: int) -> _Execution:
        """What is carried out in a row's world at this moment, planned now where the episode is new."""
        world, episode, steps_left = states.worlds[row], states.episodes[row], int(states.steps_left[row])
        T_base_object, execution = states.T_base_object[row], self._executions.get(world)
        if execution is None or not execution.goes_on(episode, T_base_object, steps_left):
            seen = T_base_object
            if self.pose_noise is not None:
                seen = self.pose_noise.perceive(seen, self._generators(tensordict, [row])[0])
            steps = min(self.steps, steps_left)
            scene = (self.objects[episode[0]], seen, states.q[row], steps, steps)
            plan = self.planner.plan(*scene, control_period=self.actions.control_period)
            execution = self._executions[world] = _Execution(
                episode, T_base_object, steps_left, plan, steps_left
            )
        execution.steps_left = steps_left
        return execution
