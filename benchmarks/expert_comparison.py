"""suite=planner: experts on the same scenes, by time of a plan and of a label, success, and consistency."""

from __future__ import annotations

import time
from collections import Counter
from importlib.resources import files

import numpy as np
import torch
from composition import compose_config
from omegaconf import DictConfig
from tensordict import TensorDict

from torchgrasp import keys
from torchgrasp.config import build, make_split_env
from torchgrasp.config.environments import make_actions
from torchgrasp.envs import GraspEnv
from torchgrasp.envs.scene import Scene
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.success import SuccessTable
from torchgrasp.geometry import goal_to_pose
from torchgrasp.objectives.functional import action_distance, pose_distance
from torchgrasp.planning import Disturb, ExpertPolicy
from torchgrasp.planning.distance import distance_field
from torchgrasp.runs import Progress
from torchgrasp.sim.kinematics import forward_kinematics

# Joint angles by which a neighbouring state differs, radians: the hand moves by some 3 mm.
_NUDGE = 0.005
# Metres of L_POSE beyond which two labels name different grasps.
_SAME_GOAL = 0.02


def make_experts(cfg: DictConfig, objects) -> dict[str, ExpertPolicy]:
    """The experts of conf/expert that `experts` names."""
    folder = files("torchgrasp.conf") / "expert"
    known = sorted(file.name.removesuffix(".yaml") for file in folder.iterdir())
    if isinstance(cfg.experts, str) or not set(cfg.experts) <= set(known):
        raise ConfigError(f"experts={cfg.experts}: give a list of some of {', '.join(known)}.")
    options = {"horizon": cfg.env.horizon, "action_space": make_actions(cfg)}
    return {name: build(compose_config(f"expert/{name}").expert, objects, **options) for name in cfg.experts}


def benchmark_planner(cfg: DictConfig) -> dict:
    """Every expert on the same scenes of the training split's objects, or of objects.split."""
    env = make_split_env(cfg, "train").base_env
    assert isinstance(env, GraspEnv)
    scenes = [env.scene(0, number) for number in range(cfg.scenes)]
    build = [_seconds(distance_field, env.objects[each]) for each in {scene.object_id for scene in scenes}]
    print(f"A distance field of an object, once: {1e3 * np.median(build):.0f} ms (median)")
    rows = {}
    for name, expert in make_experts(cfg, env.objects).items():
        row = _time_plans(expert, env, scenes, cfg.env.horizon)
        row |= _follow(cfg, name, expert, env)
        row["label_off_path_milliseconds"] = _time_corrections(cfg, expert, env)
        row |= _compare_neighbours(expert, scenes, cfg.env.horizon)
        rows[name] = row
        _print_row(name, row)
    return rows


def _print_row(name: str, row: dict) -> None:
    low, high = (100 * bound for bound in row["success_ci95"])
    median, p95 = row["plan_median_milliseconds"], row["plan_p95_milliseconds"]
    print(
        f"{name:18s} plan {median:.1f} ms (95 %: {p95:.1f}), label {row['label_milliseconds']:.2f} ms "
        f"(off its path {row['label_off_path_milliseconds']:.1f}), "
        f"success {100 * row['success_rate']:.1f} % [{low:.1f}, {high:.1f}]"
    )
    median, p95 = row["neighbour_ratio_median"], row["neighbour_ratio_p95"]
    print(
        f"{'':18s} neighbours: actions differ by {median:.2f} of the states' distance (95 %: {p95:.1f}), "
        f"another grasp {100 * row['neighbour_other_goal']:.1f} %"
    )


def _seconds(function, *args) -> float:
    start = time.perf_counter()
    function(*args)
    return time.perf_counter() - start


def _time_plans(expert: ExpertPolicy, env: GraspEnv, scenes: list[Scene], horizon: int) -> dict:
    """Plans for the starts of the scenes."""
    plans = [
        expert.planner.plan(env.objects[scene.object_id], scene.T_base_object, scene.q, horizon, horizon)
        for scene in scenes
    ]
    milliseconds = [1e3 * plan.seconds for plan in plans]
    return {
        "plan_median_milliseconds": float(np.median(milliseconds)),
        "plan_p95_milliseconds": float(np.percentile(milliseconds, 95)),
        "plan_max_milliseconds": float(np.max(milliseconds)),
        "plan_statuses": dict(Counter(plan.status.name for plan in plans)),
    }


def _follow(cfg: DictConfig, name: str, expert: ExpertPolicy, env: GraspEnv) -> dict:
    """Episodes under the expert: success, and what a label costs a step, plans included."""
    env.start_episodes_at([0] * env.num_envs)
    table, spent = SuccessTable(), []
    progress = Progress(cfg.episodes, description=name, unit="episode")
    while table.episodes < cfg.episodes:
        state, reward = env.reset(), torch.zeros(env.num_envs)
        for _ in range(cfg.env.horizon):
            spent.append(_seconds(expert, state))
            stepped = env.step(state)
            reward += stepped["next", "reward"][:, 0]
            state = stepped["next"]
        for row in range(min(env.num_envs, cfg.episodes - table.episodes)):
            table.add(env.objects.names[int(state[keys.OBJECT_ID][row])], bool(reward[row] > 0))  # pyright: ignore
            progress.update(success_rate=table.success_rate)
    progress.close()
    summary = table.summary()
    return {
        "label_milliseconds": 1e3 * float(np.sum(spent)) / (len(spent) * env.num_envs),
        **{key: summary[key] for key in ("success_rate", "success_ci95", "episodes")},
    }


def _time_corrections(cfg: DictConfig, expert: ExpertPolicy, env: GraspEnv) -> float:
    """Milliseconds of a label where another acts: the expert's action, disturbed at every step."""
    env.start_episodes_at([10_000] * env.num_envs)
    disturb, spent = Disturb(probability=1.0, until=0.0), []
    for _ in range(max(1, cfg.episodes // (4 * env.num_envs))):
        state = env.reset()
        for _ in range(cfg.env.horizon):
            spent.append(_seconds(expert, state))
            state = env.step(disturb(state))["next"]
    return 1e3 * float(np.sum(spent)) / (len(spent) * env.num_envs)


def _compare_neighbours(expert: ExpertPolicy, scenes: list[Scene], horizon: int) -> dict:
    """Labels of two states a few millimetres apart, each planned for anew, early and half way through."""
    rng = np.random.default_rng(0)
    ratios, others = [], []
    for steps_left in (horizon, horizon // 2):
        here = _states(scenes, [scene.q for scene in scenes], steps_left / horizon)
        nudged = [scene.q + rng.uniform(-_NUDGE, _NUDGE, 7) for scene in scenes]
        near = _states(scenes, nudged, steps_left / horizon, first_world=len(scenes))
        here, near = expert(here), expert(near)
        known = (here[keys.HAS_EXPERT] & near[keys.HAS_EXPERT])[:, 0]
        moved = pose_distance(here[keys.T_BASE_EE], near[keys.T_BASE_EE])
        changed = action_distance(here[keys.EXPERT_ACTION], near[keys.EXPERT_ACTION])
        goals = [state[keys.T_BASE_EE] @ goal_to_pose(state[keys.GOAL]) for state in (here, near)]
        ratios.append((changed / moved)[known])
        others.append((pose_distance(*goals) > _SAME_GOAL)[known])
    ratio, other = torch.cat(ratios).numpy(), torch.cat(others).numpy()
    return {
        "neighbour_ratio_median": float(np.median(ratio)),
        "neighbour_ratio_p95": float(np.percentile(ratio, 95)),
        "neighbour_other_goal": float(other.mean()),
    }


def _states(
    scenes: list[Scene], postures: list[np.ndarray], time_left: float, first_world: int = 0
) -> TensorDict:
    """What the expert reads, for the scenes with the arm at the postures."""
    count, q = len(scenes), np.array(postures)
    joints = np.concatenate((q, np.full((count, 2), 0.04)), axis=-1)
    objects = np.array([scene.T_base_object for scene in scenes])
    return TensorDict(
        {
            keys.T_BASE_EE: torch.from_numpy(forward_kinematics(q)).float(),
            keys.T_BASE_OBJECT: torch.from_numpy(objects).float(),
            keys.JOINTS: torch.from_numpy(joints).float(),
            keys.OBJECT_ID: torch.tensor([[scene.object_id] for scene in scenes]),
            keys.WORLD: torch.arange(first_world, first_world + count)[:, None],
            keys.EPISODE: torch.zeros(count, 1, dtype=torch.int64),
            keys.TIME_LEFT: torch.full((count, 1), time_left),
        },
        batch_size=[count],
    )
