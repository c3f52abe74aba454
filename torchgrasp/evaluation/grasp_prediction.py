"""How well grasps are predicted along the expert's trajectories (Sec. 6.5, Table 5)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, cast

import roma
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn

from torchgrasp import keys
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import goal_to_pose, invert_pose
from torchgrasp.modules import ACTOR_FEATURE, ResidualPolicy
from torchgrasp.modules.goal_keys import predicts_goal, reads_goal
from torchgrasp.objectives.functional import pose_distance
from torchgrasp.objects import GraspObject
from torchgrasp.rollouts import EpisodePool
from torchgrasp.rollouts.episode_pool import run_episodes
from torchgrasp.runs import Progress

# The hand turned half about its approach axis z: its fingers change places.
_HALF_TURN = (-1.0, -1.0, 1.0, 1.0)


class GraspErrors(NamedTuple):
    """Errors of predicted grasps, each (*): metres, degrees, metres of L_POSE."""

    translation: Tensor
    rotation: Tensor
    point_distance: Tensor


# What summary.json calls them.
_MEASURES = ("translation_m", "rotation_deg", "point_distance_m")


def with_half_turn(T_a_ee: Tensor) -> Tensor:
    """(*, 4, 4) hand poses to (*, 2, 4, 4): each, and itself turned half about its z axis.

    The two are one grasp to a parallel gripper, which looks the same from both sides.
    """
    turned = T_a_ee * T_a_ee.new_tensor(_HALF_TURN)
    return torch.stack((T_a_ee, turned), dim=-3)


def nearest_grasp(predicted: Tensor, candidates: Tensor) -> Tensor:
    """(*, 4, 4): for each predicted pose (*, 4, 4) the nearest of (*, K, 4, 4) by L_POSE, Eq. (2)."""
    distance = pose_distance(predicted.unsqueeze(-3), candidates)  # (*, K)
    index = distance.argmin(dim=-1)[..., None, None, None].expand(*distance.shape[:-1], 1, 4, 4)
    return candidates.expand(*distance.shape, 4, 4).gather(-3, index).squeeze(-3)


def grasp_errors(predicted: Tensor, candidates: Tensor) -> GraspErrors:
    """Errors of predicted hand poses (*, 4, 4) against the nearest of the candidates (*, K, 4, 4).

    As Sec. 6.5 has it: the distance of the two origins in metres, the angle between the two rotations in
    degrees, and the point distance "as used in the loss function in Eq. (2)": L_POSE in metres, the L1
    norm averaged over the hand's six control points. Both poses are in one frame, whichever it is.

    Example:
        >>> moved = torch.eye(4)
        >>> moved[:3, 3] = torch.tensor([0.03, 0.0, 0.04])
        >>> [round(error.item(), 3) for error in grasp_errors(moved, torch.eye(4)[None])]
        [0.05, 0.0, 0.07]
    """
    true = nearest_grasp(predicted, candidates)
    translation = torch.linalg.vector_norm(predicted[..., :3, 3] - true[..., :3, 3], dim=-1)
    angle = roma.rotmat_geodesic_distance(predicted[..., :3, :3], true[..., :3, :3])
    return GraspErrors(translation, angle.rad2deg(), pose_distance(predicted, true))


class GraspPredictionTable:
    """Means over trajectories of the least and of the mean error along each, as in Table 5.

    The paper measures against the goal that the expert pursues and does not say whether the hand's half
    turn counts as another grasp: both readings stand side by side, and the error to the nearest of all
    known grasps. Each measure's least error is taken for itself.

    Example:
        >>> table = GraspPredictionTable()
        >>> goal = torch.eye(4).expand(2, 4, 4)
        >>> predicted = goal.clone()
        >>> predicted[:, 0, 3] = torch.tensor([0.03, 0.01])
        >>> table.add(predicted, goal, known=goal[:, None])
        >>> {name: round(value, 3) for name, value in table.summary()["expert_goal"]["translation_m"].items()}
        {'min': 0.01, 'mean': 0.02}
    """

    def __init__(self) -> None:
        self._rows: dict[str, list[Tensor]] = {}

    def add(self, predicted: Tensor, goal: Tensor, *, known: Tensor) -> None:
        """Count a trajectory's T predictions (T, 4, 4), T > 0, against its goals (T, 4, 4).

        `known` (T, K, 4, 4) are all of the object's grasps; all poses of a step are in one frame.
        """
        readings = {
            "expert_goal": goal.unsqueeze(-3),
            "expert_goal_or_half_turn": with_half_turn(goal),
            "nearest_known_grasp": known,
        }
        for name, candidates in readings.items():
            errors = torch.stack(grasp_errors(predicted, candidates))  # (3, T)
            row = torch.stack((errors.amin(dim=-1), errors.mean(dim=-1)), dim=-1)
            self._rows.setdefault(name, []).append(row)

    @property
    def trajectories(self) -> int:
        """How many were counted."""
        return len(next(iter(self._rows.values()), []))

    def summary(self) -> dict:
        """{reading: {measure: {min, mean}}} in metres and degrees, and the number of `trajectories`."""
        table: dict = {"trajectories": self.trajectories}
        for name, rows in self._rows.items():
            means = torch.stack(rows).mean(dim=0).tolist()  # (3, 2)
            table[name] = {
                measure: dict(zip(("min", "mean"), row, strict=True))
                for measure, row in zip(_MEASURES, means, strict=True)
            }
        return table


class GraspPredictions(TensorDictModuleBase):
    """Lets one policy act while networks only predict grasps from what it sees.

    Each network's goal (*, 7), ee frame, is written as ``("grasp_prediction", <its name>)``; whatever else
    it writes is dropped. A critic, which reads the action, is given the driver's.

    Args:
        driver: writes ACTION, and GOAL where it knows it.
        networks: by name; each writes GOAL_PREDICTION or, as a GoalPredictor does, GOAL.

    Example:
        >>> from tensordict import TensorDict
        >>> from torchgrasp.modules import GoalPredictor, PointNet
        >>> from torchgrasp.planning import RandomAction
        >>> policy = GraspPredictions(RandomAction(), {"goal_network": GoalPredictor(PointNet)})
        >>> state = {key: torch.zeros(1, dtype=torch.long) for key in ("world", "episode")}
        >>> td = TensorDict({**state, "points": torch.rand(262, 4), "time_left": torch.ones(1)})
        >>> policy(td)["grasp_prediction", "goal_network"].shape, "goal" in td
        (torch.Size([7]), False)
    """

    def __init__(self, driver: TensorDictModuleBase, networks: Mapping[str, TensorDictModuleBase]) -> None:
        super().__init__()
        self.driver, self.networks = driver, nn.ModuleDict(networks)
        read = [key for network in networks.values() for key in network.in_keys if key != keys.ACTION]
        self.in_keys = list(dict.fromkeys([*driver.in_keys, *read]))  # pyright: ignore
        written = [(keys.GRASP_PREDICTION, name) for name in networks]
        self.out_keys = [*driver.out_keys, *written]  # pyright: ignore

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the driver's keys and every network's prediction (*, 7)."""
        tensordict = self.driver(tensordict)
        for name, network in self.networks.items():
            seen = network(tensordict.select(*network.in_keys))  # pyright: ignore
            auxiliary = keys.GOAL_PREDICTION in network.out_keys  # pyright: ignore
            goal = seen.get(keys.GOAL_PREDICTION if auxiliary else keys.GOAL)
            tensordict.set((keys.GRASP_PREDICTION, name), goal)
        return tensordict


def find_predictors(networks: Mapping[str, TensorDictModuleBase]) -> dict[str, TensorDictModuleBase]:
    """Those of a policy's networks that predict grasps, each behind the goal network if it reads goals.

    A critic that reads goals where the actor has no goal network is left out: it is told the answer.
    """
    goal_network = networks.get("goal_network")
    predictors = {} if goal_network is None else {"goal_network": goal_network}
    for each in ("actor", "critic"):
        if each not in networks or not predicts_goal(networks[each]):
            continue
        if each == "critic" and ACTOR_FEATURE in networks[each].in_keys:
            reading: list = [cast(ResidualPolicy, networks["actor"]).encoder, networks[each]]
            predictors[each] = TensorDictSequential(*reading)
        elif not reads_goal(networks[each]):
            predictors[each] = networks[each]
        elif goal_network is not None:
            modules: list = [goal_network, networks[each]]
            predictors[each] = TensorDictSequential(*modules)
    if not predictors:
        raise ConfigError("networks predict no goal: give an actor or a critic with goal_prediction=True.")
    return predictors


def measure_grasp_prediction(
    pool: EpisodePool,
    expert: TensorDictModuleBase,
    objects: Sequence[GraspObject],
    predictors: Mapping[str, TensorDictModuleBase],
    *,
    num_episodes: int,
    num_envs: int,
    watch: Callable[[str, TensorDictBase, Tensor, Tensor], None] | None = None,
) -> dict[str, dict]:
    """{network: its row of Table 5} on the scenes of the environment `test`, which the expert drives through.

    Args:
        pool: hands over T_BASE_EE, T_BASE_OBJECT, OBJECT_ID, GOAL, HAS_GOAL and GRASP_PREDICTION.
        expert: drives, and knows its goal.
        objects: that OBJECT_ID counts in.
        predictors: of `find_predictors`.
        num_episodes: that count.
        num_envs: worlds of the environment.
        watch: is shown (object name, steps (T,), predictions (T, 4, 4), known grasps (T, K, 4, 4)) of the
            first network along each trajectory, poses in the ee frame.
    """
    policy = GraspPredictions(expert, predictors)
    tables = {name: GraspPredictionTable() for name in predictors}
    episodes = run_episodes(pool, "test", policy, num_episodes=num_episodes, num_envs=num_envs)
    with Progress(num_episodes, description="grasp prediction", unit="episode") as progress:
        for episode in episodes:
            progress.update()
            grasps = torch.from_numpy(objects[int(episode.steps[keys.OBJECT_ID][0])].grasps)
            steps = episode.steps[episode.steps[keys.HAS_GOAL][:, 0]]
            if not len(steps):
                continue
            known = (invert_pose(steps[keys.T_BASE_EE]) @ steps[keys.T_BASE_OBJECT])[:, None] @ grasps
            for name, table in tables.items():
                predicted = goal_to_pose(steps[keys.GRASP_PREDICTION, name])
                table.add(predicted, goal_to_pose(steps[keys.GOAL]), known=known)
                if watch is not None and name == next(iter(tables)):
                    watch(episode.object_name, steps, predicted, known)
    return {name: table.summary() for name, table in tables.items()}
