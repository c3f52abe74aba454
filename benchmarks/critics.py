"""suite=critics: what critics learn from a trained policy's own episodes, by how they learn."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from composition import compose_config
from omegaconf import DictConfig
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.data import MultiStep
from torchrl.envs.utils import step_mdp

from torchgrasp import keys
from torchgrasp.config import evaluation_config, make_pool, make_split_env, prepare_objects
from torchgrasp.config.networks import rebuild_acting, without_correction
from torchgrasp.config.weights_files import read_trained
from torchgrasp.data import split_tries
from torchgrasp.errors import ConfigError
from torchgrasp.evaluation.value_quality import ValueTable, area_under_curve
from torchgrasp.geometry import ACTION_BOUND
from torchgrasp.modules import ExploringStep, GivenFeature, GraspCritic, NearbyActions, split_network
from torchgrasp.modules.policy import join_policy
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate
from torchgrasp.rollouts.episode_pool import copy_for_rollouts

_FEATURE = (keys.FEATURES, "actor")
_TRIED = (keys.TRIED_ACTION, ("next", keys.TRIED_REWARD))
_BATCH = 256
# A step ahead that no episode of ours has: with it the target is the return.
_ALL = 1000
_WAY = re.compile(r"(return|tries|([1-9]\d*)-step)(, layer)?(?:, ([1-9]\d*) values)?")


def benchmark_critics(cfg: DictConfig) -> list[dict]:
    """A row for each way to learn: values against the ends of held-out episodes, and of last actions."""
    options, ways = cfg.critics, {name: _read_way(name) for name in cfg.critics.ways}
    chosen = [f"policy={options.policy}", f"collector.num_workers={cfg.collector.num_workers}"]
    evaluated = evaluation_config(compose_config("evaluate", [*chosen, *options.overrides]))
    trained = without_correction(read_trained(Path(str(options.policy)), evaluated.trust))
    encoder, rest = split_network(join_policy(rebuild_acting(trained)), _FEATURE)
    policy: list = [encoder, rest]
    acting = TensorDictSequential(*policy)
    trying = any(steps is None for steps, _, _ in ways.values())
    learned, held, tries = _collect(evaluated, acting, options, trying=trying)
    tried = _try_actions(evaluated, acting, options)
    rows = []
    for name, (steps, norm, num_q) in ways.items():
        torch.manual_seed(cfg.seed)
        started = time.perf_counter()
        read = tries if steps is None else _look_ahead(learned, steps, options.gamma)
        critic = _learn(rest, read, options, norm=norm, num_q=num_q)
        row = {"way": name, "seconds": time.perf_counter() - started, "episodes": len(learned)}
        row |= {"quality": _score(critic, held, options.gamma), **_rank(critic, tried)}
        rows.append(row)
        print(_tell(row), flush=True)
    return rows


def _read_way(name: str) -> tuple[int | None, Any, int]:
    """`<n>-step|return|tries[, layer][, <Q> values]` as (n, norm, Q); n is None for tries."""
    found = _WAY.fullmatch(name)
    if found is None:
        raise ConfigError(
            f"critics.ways has {name!r}: give <n>-step, return or tries, then, or not, ', layer' and "
            "', <Q> values'."
        )
    kind, steps, layer, values = found.groups()
    ahead = None if kind == "tries" else int(steps or _ALL)
    return ahead, "layer" if layer else "none", int(values or 2)


def _collect(
    cfg: DictConfig, acting: TensorDictModuleBase, options: DictConfig, *, trying: bool
) -> tuple[TensorDictBase, TensorDictBase, TensorDictBase | None]:
    """Episodes (E, T) of features, each with one large change of an action: to learn from, and held out.

    Where `trying`, the transitions (K) of the actions tried at the ends of the former come third.
    """
    horizon, reach = cfg.env.horizon, options.reach
    explore = ExploringStep(horizon=horizon, first=options.first, reach=reach)
    propose = [NearbyActions(horizon=horizon, num_tries=options.tries, reach=reach)] if trying else []
    read = [_FEATURE, keys.TIME_LEFT, keys.TABLE_PLANE, keys.WRIST_ANGLE, keys.ACTION]
    with make_pool(cfg, keep=[*read, keys.TRIED_ACTION, keys.TRIED_REWARD]) as pool:
        prepare_objects(cfg)

        def run(split: str, wanted: int, worlds: int, *modules: Any) -> list[TensorDictBase]:
            policy = copy_for_rollouts(TensorDictSequential(*modules))
            batches = pool.run(split, policy, range(10_000, 10_000 + -(-wanted // worlds)), explore=True)
            episodes = [each.steps for batch in batches for each in batch if len(each.steps) == horizon]
            return [_follow(steps, read) for steps in episodes[:wanted]]

        learned = run("train", options.episodes, cfg.env.num_envs, acting, *propose, explore)
        held = run("test", options.held_out, cfg.evaluation.num_envs, acting, explore)
    tries: Any = torch.cat([split_tries(steps).reshape(-1) for steps in learned]) if trying else None
    return _stack("train", learned), _stack("held out", held), tries


def _stack(name: str, episodes: list[TensorDictBase]) -> TensorDictBase:
    """Episodes (E, T) without what was tried in them; tells how many succeeded."""
    stacked: Any = torch.stack([steps.exclude(*_TRIED) for steps in episodes])
    print(f"{name}: {len(stacked)} episodes, {_outcomes(stacked).mean():.1%} successful", flush=True)
    return stacked


def _follow(steps: TensorDictBase, read: list) -> TensorDictBase:
    """An episode (T) with the next of each observation; of the last step, which ends it, its own."""
    index = torch.arange(1, len(steps) + 1).clamp(max=len(steps) - 1)
    following: Any = steps.select(*read[:-1])[index]
    after: Any = steps["next"]
    ends = after.select("reward", "terminated", "done", keys.TRIED_REWARD, strict=False)
    return steps.select(*read, keys.TRIED_ACTION, strict=False).set("next", following.update(ends))


def _outcomes(episodes: TensorDictBase) -> Tensor:
    """1 for the episodes (E, T) that succeeded, else 0: (E)."""
    rewards: Any = episodes["next", "reward"]
    return rewards.sum(dim=(-1, -2)).clamp(max=1.0)


@torch.no_grad()
def _try_actions(cfg: DictConfig, acting: TensorDictModuleBase, options: DictConfig) -> TensorDictBase:
    """Last states (S) of held-out scenes with `tries` actions (S, M, 6) each, and their outcomes (S, M)."""
    env = make_split_env(cfg, "test")
    found: Any = []
    generator, bound = torch.Generator().manual_seed(0), torch.tensor(ACTION_BOUND)
    acting = copy_for_rollouts(acting)  # pyright: ignore[reportAssignmentType]
    worlds = env.batch_size[0]
    for number in range(20_000, 20_000 + -(-options.states // worlds)):
        env.start_episodes_at([number] * worlds)
        state = acting(env.reset())
        for _ in range(env.horizon - 1):
            state = acting(step_mdp(env.step(state)))
        change = torch.randn(worlds, options.tries, 6, generator=generator)
        size = torch.rand(worlds, options.tries, 1, generator=generator) * options.reach
        change = size * torch.nn.functional.normalize(change, dim=-1)
        change[:, 0] = 0.0
        tried = (state[keys.ACTION].unsqueeze(1) + change * bound).clamp(-bound, bound)
        outcomes = env.try_last_actions(tried)
        seen = state.select(_FEATURE, keys.TIME_LEFT, keys.TABLE_PLANE, keys.WRIST_ANGLE)
        found.append(seen.set("tried", tried).set("lifted", outcomes))
    env.close()
    states: Any = torch.cat(found)
    return states[: options.states]


def _look_ahead(episodes: TensorDictBase, steps: int, gamma: float) -> TensorDictBase:
    """Transitions (E x T) of episodes (E, T), `steps` steps ahead."""
    if steps > 1:
        episodes = MultiStep(gamma, min(steps, episodes.shape[-1]) - 1)(episodes.clone())
    return episodes.reshape(-1)


def _learn(
    actor: TensorDictModuleBase, rows: TensorDictBase, options: DictConfig, **head: Any
) -> GraspCritic:
    """A critic on the actor's features after `updates` of Eq. (3) on transitions (K), without goals."""
    read = [_FEATURE, keys.TIME_LEFT, keys.ACTION]
    inputs: Any = {keys.WRIST_ANGLE: 1}
    size = rows[_FEATURE].shape[-1]
    critic = GraspCritic(
        GivenFeature(size),
        fusion="late",
        in_keys=read,
        state_inputs=inputs,
        table_input=True,
        goal_prediction=False,
        **head,
    )
    loss = GraspTD3BCLoss(
        actor, critic, bc_weight=1.0, aux_weight=0.0, action_bound=ACTION_BOUND, value_limits=(0.0, 1.0)
    )
    loss.make_value_estimator(gamma=options.gamma)
    targets = StaggeredTargetUpdate(loss, tau=0.01, period=200)
    adam = torch.optim.AdamW(critic.parameters(), lr=options.learning_rate)
    for _ in range(options.updates):
        batch = rows[torch.randint(len(rows), (_BATCH,))]
        adam.zero_grad()
        loss.critic_loss(batch)["loss_qvalue"].backward()
        adam.step()
        targets.step()
    return critic.eval()


@torch.no_grad()
def _score(critic: GraspCritic, episodes: TensorDictBase, gamma: float) -> dict:
    """What the values of held-out episodes tell of their ends."""
    table = ValueTable(gamma=gamma)
    values = critic(episodes.select(*critic.in_keys))[keys.STATE_ACTION_VALUE].amin(dim=-1)
    for each, won in zip(values, _outcomes(episodes), strict=True):
        table.add(each.numpy(), success=bool(won))
    return table.summary()


@torch.no_grad()
def _rank(critic: GraspCritic, states: TensorDictBase) -> dict[str, float]:
    """How well values order the actions tried in one state, and what is lifted by the best of them."""
    tried, lifted = states["tried"], states["lifted"]
    repeated = states.exclude("tried", "lifted").unsqueeze(1).expand(*lifted.shape).clone()
    values = critic(repeated.set(keys.ACTION, tried))[keys.STATE_ACTION_VALUE].amin(dim=-1)
    areas = list(_areas(values, lifted))
    liftable: Any = lifted.any(dim=1)  # torch's stubs: a bool
    best = lifted.gather(1, values.argmax(dim=1, keepdim=True))
    smallest = -(tried - tried[:, :1]).div(torch.tensor(ACTION_BOUND)).norm(dim=-1)
    plain = list(_areas(smallest, lifted))
    return {
        "states": len(states),
        "auc_of_actions": sum(areas) / max(1, len(areas)),
        "auc_of_small_changes": sum(plain) / max(1, len(plain)),
        "lifted_by_policy": lifted[:, 0].float().mean().item(),
        "lifted_by_best": best.float().mean().item(),
        "lifted_by_any": liftable.float().mean().item(),
    }


def _areas(scores: Tensor, lifted: Tensor) -> Iterator[float]:
    """The area under the curve of each state in which some actions lift and others do not."""
    for row, outcome in zip(scores.numpy(), lifted.numpy(), strict=True):
        area = area_under_curve(row, outcome)
        if area is not None:
            yield area


def _tell(row: dict) -> str:
    steps = {left: each["auc"] for left, each in row["quality"]["steps_left"].items()}
    areas = ", ".join(f"{left} {'-' if area is None else f'{area:.2f}'}" for left, area in steps.items())
    shares = f"{row['lifted_by_policy']:.1%}, by the critic's choice {row['lifted_by_best']:.1%}"
    shares += f", by any of those tried {row['lifted_by_any']:.1%}"
    return (
        f"critic {row['way']:24} area by steps left: {areas}; of actions in a state "
        f"{row['auc_of_actions']:.2f}, by small changes {row['auc_of_small_changes']:.2f}; "
        f"lifted by the policy's action {shares}; {row['seconds']:.0f} s"
    )
