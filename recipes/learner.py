"""Everything a training run changes, so that one checkpoint holds it all."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from networks import (
    check_frozen,
    join_policy,
    load_networks,
    make_codec,
    make_networks,
    make_row,
    predicts_goal,
)
from omegaconf import DictConfig
from origin import check_rows
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.data import MixtureReplayBuffer, Priority, estimate_bytes, open_demonstrations
from torchgrasp.data.files import find_folder
from torchgrasp.data.kinds import find_counted, resolve_count
from torchgrasp.data.memory import check_space, count_row_bytes
from torchgrasp.errors import CheckpointError
from torchgrasp.objectives import GoalAuxLoss, PoseBCLoss, StaggeredTargetUpdate
from torchgrasp.training import (
    cosine_schedule,
    get_rng_state,
    load_checkpoint,
    save_checkpoint,
    seed_everything,
    set_rng_state,
    step_schedule,
)

_RECENT_EPISODES = 200


class Learner:
    """Networks, losses, optimizers, replay buffer and counters of one run.

    Args:
        cfg: the recipe's configuration.
        shapes: of the observations, as `common.observed_shapes` tells them.
    """

    def __init__(self, cfg: DictConfig, shapes: Mapping[Any, tuple[int, ...]]) -> None:
        seed_everything(cfg.seed)
        self.cfg = cfg
        self.networks = {name: each.to(cfg.device) for name, each in make_networks(cfg.model).items()}
        if cfg.resume is None:
            self._begin_with(cfg)
        self.actor, self.critic = self.networks["actor"], self.networks["critic"]
        self.loss = instantiate(cfg.loss, self.actor, self.critic).to(cfg.device)
        self.loss.make_value_estimator(gamma=cfg.online.gamma)
        self.targets = StaggeredTargetUpdate(self.loss, tau=cfg.online.tau, period=cfg.online.period)
        self.imitation = PoseBCLoss(
            self.actor,
            distance=self.loss.distance,
            aux_weight=cfg.pretrain.aux_weight if predicts_goal(self.actor) else 0.0,
            goal_distance=self.loss.goal_distance,
        )
        self.grasp_prediction: GoalAuxLoss | None = None
        if "goal_network" in self.networks:
            distance = self.loss.goal_distance
            self.grasp_prediction = GoalAuxLoss(self.networks["goal_network"], distance=distance)
            self.grasp_prediction.set_keys(goal_prediction=keys.GOAL)
        self.optimizers = {name: torch.optim.Adam(each.parameters()) for name, each in self.networks.items()}
        self.noise = instantiate(cfg.collector.noise).to(cfg.device)
        self.expert_start = instantiate(cfg.collector.expert_start)
        self.buffer: MixtureReplayBuffer
        self._codec = make_codec(cfg, self.networks)
        self._augment = instantiate(cfg.replay.augment)
        self._row = make_row(self._codec, self._augment, shapes)
        self._priority: Priority | None = instantiate(cfg.replay.priority)
        row_bytes = count_row_bytes(self._row, prioritised=self._priority is not None)
        rows = cfg.replay.online_capacity + cfg.demonstrations.steps
        check_space(rows, row_bytes, folder=cfg.replay.folder)  # before hours of collecting
        self._imitation_rate = cosine_schedule(
            max(1, cfg.pretrain.steps), warmup_steps=min(200, cfg.pretrain.steps // 10)
        )
        self._online_rate = step_schedule(
            [round(1000 * m) for m in cfg.online.milestones], gamma=cfg.online.decay
        )
        self.pretrain_steps = self.gradient_steps = self.env_steps = self.iterations = 0
        self.results: dict = {}
        self._recent: deque[bool] = deque(maxlen=_RECENT_EPISODES)
        self._started, self._earlier_seconds = time.monotonic(), 0.0

    def _begin_with(self, cfg: DictConfig) -> None:
        """The weights that `init` names."""
        if cfg.init is None:
            check_frozen(cfg.model, self.networks)
        else:
            load_networks(self.networks, Path(str(cfg.init)))

    @property
    def wall_seconds(self) -> float:
        """Seconds spent on this run, those before a resume included."""
        return self._earlier_seconds + time.monotonic() - self._started

    @property
    def policy(self) -> TensorDictModuleBase:
        """What is evaluated."""
        return join_policy(self.networks)

    def make_buffer(self, demonstrations: Path) -> None:
        """An empty buffer with room for the demonstrations below the path."""
        cfg, opened = self.cfg, open_demonstrations(demonstrations)
        check_rows(opened, self._row)
        self._demonstrations = opened
        share = cfg.replay.online_fraction
        capacities = {"online": cfg.replay.online_capacity, "expert": opened.card["rows"]}
        self._shares = {"online": share, "expert": 1.0 - share}
        prioritised = self._priority is not None
        size = estimate_bytes(sum(capacities.values()), self._row, prioritised=prioritised)
        print(f"Replay buffer: up to {size / 1e9:.2f} GB for {capacities} transitions")
        self.buffer = MixtureReplayBuffer(
            capacities,
            self._shares,
            batch_size=cfg.replay.batch_size,
            seed=cfg.seed,
            folder=cfg.replay.folder,
            row=self._row,
            priority=self._priority,
            codec=self._codec,
            transform=self._augment,
        )

    def load_demonstrations(self) -> None:
        """Fill D_expert with the demonstrations' steps that count, by default the successful ones."""
        count = resolve_count(self.cfg.demonstrations.count, self._demonstrations.card["kind"])
        for rows in self._demonstrations.iterate_rows():
            self.buffer.extend_rows(rows[find_counted(rows, count)], source="expert")

    def describe(self) -> dict:
        """Demonstrations (kind, episodes, successes, steps, bytes), seconds and steps of this run."""
        card = self._demonstrations.card
        names = ("kind", "episodes", "successes", "steps", "successful_steps", "bytes")
        counts = ("wall_seconds", "env_steps", "gradient_steps")
        return {
            "demonstrations": {name: card[name] for name in names},
            **{name: getattr(self, name) for name in counts},
        }

    def begin_imitation(self) -> None:
        """Draw from D_expert alone."""
        self.buffer.set_shares({"online": 0.0, "expert": 1.0})

    def begin_reinforcement(self) -> None:
        """Draw from both sources, with targets that know what imitation has taught."""
        self.buffer.set_shares(self._shares)
        if self.iterations == 0:
            self.targets.copy()

    def imitate(self, batch: TensorDictBase) -> dict[str, float]:
        """One update of imitation and goal prediction, of the critic too where configured."""
        rate = self.cfg.pretrain.learning_rate * self._imitation_rate(self.pretrain_steps)
        for name in self.optimizers:
            self._set_rate(name, rate)
        metrics = self._descend("actor", self.imitation(batch)) | self._update_goal_network(batch)
        if self.cfg.pretrain.critic:
            metrics |= self.update_critic(batch)
        else:
            self.gradient_steps += 1
        self.pretrain_steps += 1
        return metrics

    def update_critic(self, batch: TensorDictBase) -> dict[str, float]:
        """One update after Eq. (3), and the targets' step."""
        metrics = self._descend("critic", self.loss.critic_loss(batch))
        self.buffer.update_tensordict_priority(batch)
        self.targets.step()
        self.gradient_steps += 1
        return metrics

    def update_actor(self, batch: TensorDictBase) -> dict[str, float]:
        """One update after Eq. (4), and one of the goal network where there is one."""
        return self._descend("actor", self.loss.actor_loss(batch)) | self._update_goal_network(batch)

    def _update_goal_network(self, batch: TensorDictBase) -> dict[str, float]:
        """Grasp prediction alone, on the labels (Table 5, Goal-Conditioned)."""
        if self.grasp_prediction is None:
            return {}
        return self._descend("goal_network", self.grasp_prediction(batch))

    def _descend(self, name: str, terms: TensorDictBase) -> dict[str, float]:
        optimizer = self.optimizers[name]
        optimizer.zero_grad(set_to_none=True)
        losses = [value for key, value in terms.items() if str(key).startswith("loss_")]
        torch.stack(losses).sum().backward()
        optimizer.step()
        return {f"{name}/{key}": value.item() for key, value in terms.items()}

    def set_rates(self, progress: float) -> None:
        """The piecewise schedule of the online phase (Sec. 6.4), and beta; `progress` in [0, 1]."""
        for name in self.optimizers:
            self._set_rate(name, self.cfg.online.learning_rate * self._online_rate(round(1000 * progress)))
        if self._priority is not None:
            first = self._priority.beta
            self.buffer.beta = first + progress * (1.0 - first)  # Schaul et al. 2016, Sec. 3.4

    def _set_rate(self, name: str, rate: float) -> None:
        for group in self.optimizers[name].param_groups:
            group["lr"] = rate

    def note_successes(self, successes: list[bool]) -> float:
        """Success rate of the last 200 episodes, these included."""
        self._recent.extend(successes)
        return sum(self._recent) / len(self._recent)

    def checkpoint(self, run_dir: Path) -> None:
        """Write everything that a resumed run needs, all or nothing."""
        save_checkpoint(
            run_dir / "checkpoint",
            {
                "loss": self.loss.state_dict(),
                "goal_network": self._goal_state(),
                "targets": self.targets.state_dict(),
                "optimizers": {name: each.state_dict() for name, each in self.optimizers.items()},
                "noise": self.noise.state_dict(),
                "buffer": self.buffer.state_dict(),
                "random": get_rng_state(),
                "progress": {
                    **{name: getattr(self, name) for name in _COUNTERS},
                    "results": self.results,
                    "recent": list(self._recent),
                    "wall_seconds": self.wall_seconds,
                },
            },
        )

    def _goal_state(self) -> dict:
        return self.networks["goal_network"].state_dict() if self.grasp_prediction else {}

    def resume(self, run_dir: Path) -> bool:
        """Take up the checkpoint of `run_dir`; False where it has none yet."""
        if not find_folder(run_dir / "checkpoint").exists():
            return False
        state = load_checkpoint(run_dir / "checkpoint")
        try:
            self._take_up(state)
        except (KeyError, RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0][:200]
            raise CheckpointError(
                f"{run_dir}/checkpoint is of another configuration ({reason}): resume it as it was begun."
            ) from error
        return True

    def _take_up(self, state: dict) -> None:
        self.loss.load_state_dict(state["loss"])
        self.targets.load_state_dict(state["targets"])
        if self.grasp_prediction:
            self.networks["goal_network"].load_state_dict(state["goal_network"])
        for name, optimizer in self.optimizers.items():
            optimizer.load_state_dict(state["optimizers"][name])
        self.noise.load_state_dict(state["noise"])
        self.buffer.load_state_dict(state["buffer"])
        set_rng_state(state["random"])
        progress = state["progress"]
        for name in _COUNTERS:
            setattr(self, name, progress[name])
        self.results, self._earlier_seconds = progress["results"], progress["wall_seconds"]
        self._recent.extend(progress["recent"])


_COUNTERS = ("pretrain_steps", "gradient_steps", "env_steps", "iterations")
