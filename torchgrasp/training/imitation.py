"""A policy that learns by imitation, and everything else of a run that a checkpoint must hold."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from experience import Experience
from hydra.utils import instantiate
from networks import begin_networks, join_policy, make_networks, predicts_goal
from omegaconf import DictConfig, OmegaConf
from schedule import count_offline_updates
from settings import has_checkpoint
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.data import MixtureReplayBuffer
from torchgrasp.errors import CheckpointError
from torchgrasp.geometry import ACTION_SIZE, GOAL_SIZE
from torchgrasp.objectives import GoalAuxLoss, PoseBCLoss, functional
from torchgrasp.rollouts.episode_pool import Episode
from torchgrasp.runs.checkpoint import load_checkpoint, save_checkpoint
from torchgrasp.runs.seeding import get_rng_state, seed_everything, set_rng_state
from torchgrasp.runs.stopwatch import Stopwatch
from torchgrasp.runs.weights import save_weights
from torchgrasp.training.schedules import cosine_schedule, step_schedule

_RECENT_EPISODES = 200
_COUNTERS = ("pretrain_steps", "gradient_steps", "env_steps", "iterations")


class Imitator:
    """Actor, goal network if the actor reads goals, their losses and optimizers, experience and counters.

    Args:
        cfg: the recipe's configuration.
        shapes: of the observations, as `common.observed_shapes` tells them.
        critic: whether there is a critic among the networks.
        own: name of the source that the run's episodes are added to.
    """

    def __init__(
        self,
        cfg: DictConfig,
        shapes: Mapping[Any, tuple[int, ...]],
        *,
        critic: bool = False,
        own: str = "online",
    ) -> None:
        seed_everything(cfg.seed)
        self.cfg = cfg
        made = make_networks(cfg.model, critic=critic)
        self.networks = {name: each.to(cfg.device) for name, each in made.items()}
        if not has_checkpoint(cfg.resume):
            begin_networks(cfg, self.networks)
        self.actor = self.networks["actor"]
        self._make_losses()
        self.optimizers = {name: torch.optim.Adam(each.parameters()) for name, each in self.networks.items()}
        self.noise = instantiate(cfg.collector.noise).to(cfg.device)
        self.expert_start = instantiate(cfg.collector.expert_start)
        self.experience = Experience(cfg, self.networks, shapes, own=own)
        self._imitation_rate = cosine_schedule(
            max(1, cfg.pretrain.steps), warmup_steps=min(200, cfg.pretrain.steps // 10)
        )
        self._online_rate = step_schedule(
            [round(1000 * m) for m in cfg.online.milestones], gamma=cfg.online.decay
        )
        self.pretrain_steps = self.gradient_steps = self.env_steps = self.iterations = 0
        self.results: dict = {}
        self.stopwatch = Stopwatch()
        self._recent: deque[bool] = deque(maxlen=_RECENT_EPISODES)
        self._started, self._earlier_seconds = time.monotonic(), 0.0

    def _make_losses(self) -> None:
        distance, goal_distance = self._distances()
        for measure, size in ((distance, ACTION_SIZE), (goal_distance, GOAL_SIZE)):
            # Refuses a wrong norm before anything is collected.
            measure(torch.ones(1, size), torch.ones(1, size))
        self.imitation = PoseBCLoss(
            self.actor,
            distance=distance,
            aux_weight=self.cfg.pretrain.aux_weight if predicts_goal(self.actor) else 0.0,
            goal_distance=goal_distance,
        )
        self.grasp_prediction: GoalAuxLoss | None = None
        if "goal_network" in self.networks:
            self.grasp_prediction = GoalAuxLoss(self.networks["goal_network"], distance=goal_distance)
            self.grasp_prediction.set_keys(goal_prediction=keys.GOAL)

    def _distances(self) -> tuple[Any, Any]:
        """L_POSE between actions and between goals, as `loss` has them."""
        defaults = {"distance": functional.action_distance, "goal_distance": functional.goal_distance}
        chosen = {name: OmegaConf.select(self.cfg.loss, name) for name in defaults}
        action, goal = (defaults[n] if each is None else instantiate(each) for n, each in chosen.items())
        return action, goal

    @property
    def buffer(self) -> MixtureReplayBuffer:
        """The replay buffer, once the demonstrations are known."""
        return self.experience.buffer

    @property
    def wall_seconds(self) -> float:
        """Seconds spent on this run, those before a resume included."""
        return self._earlier_seconds + time.monotonic() - self._started

    @property
    def policy(self) -> TensorDictModuleBase:
        """What is evaluated."""
        return join_policy(self.networks)

    @property
    def progress(self) -> float:
        """Share of the main phase that is done, by updates where it is offline, else by steps."""
        if total := count_offline_updates(self.cfg):
            return self.iterations * self.cfg.online.updates / total
        return self.env_steps / self.cfg.total_env_steps if self.cfg.total_env_steps else 1.0

    @property
    def updates_ahead(self) -> int:
        """Updates of this iteration: `online.updates`, or the last ones of an offline run."""
        total, each = count_offline_updates(self.cfg), self.cfg.online.updates
        return min(each, total - self.iterations * each) if total else each

    def describe(self) -> dict:
        """Demonstrations, seconds and steps of this run."""
        counts = ("wall_seconds", "env_steps", "gradient_steps")
        return {**self.experience.describe(), **{name: getattr(self, name) for name in counts}}

    def pretrain(self, batch: TensorDictBase) -> dict[str, float]:
        """One update of imitation at the rate of that phase."""
        self._set_rates(self.cfg.pretrain.learning_rate * self._imitation_rate(self.pretrain_steps))
        self.pretrain_steps += 1
        return self.imitate(batch)

    def imitate(self, batch: TensorDictBase) -> dict[str, float]:
        """One update of L_BC and L_AUX, and one of the goal network where there is one."""
        self.gradient_steps += 1
        return self._descend("actor", self.imitation(batch)) | self._update_goal_network(batch)

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
        """The piecewise schedule of the main phase (Sec. 6.4), and beta; `progress` in [0, 1]."""
        self._set_rates(self.cfg.online.learning_rate * self._online_rate(round(1000 * progress)))
        if (priority := self.experience.priority) is not None:
            self.buffer.beta = priority.beta + progress * (
                1.0 - priority.beta
            )  # Schaul et al. 2016, Sec. 3.4

    def _set_rates(self, rate: float) -> None:
        for optimizer in self.optimizers.values():
            for group in optimizer.param_groups:
                group["lr"] = rate

    def note_successes(self, episodes: Iterable[Episode]) -> None:
        """Count these episodes of the learner in its success rate."""
        self._recent.extend(episode.success for episode in episodes)

    @property
    def success_rate(self) -> float | None:
        """Of the learner's last 200 episodes; None before the first."""
        return sum(self._recent) / len(self._recent) if self._recent else None

    def checkpoint(self, run_dir: Path) -> None:
        """Write everything that a resumed run needs, all or nothing, and the weights as they are now."""
        save_checkpoint(run_dir / "checkpoint", self._state())
        config: Any = OmegaConf.to_container(self.cfg, resolve=True)
        save_weights(run_dir / "weights.safetensors", self.networks, config)

    def _state(self) -> dict[str, Any]:
        return {
            "networks": {name: each.state_dict() for name, each in self.networks.items()},
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
        }

    def resume(self, run_dir: Path) -> bool:
        """Take up the checkpoint of `run_dir`; False where it has none yet."""
        if not has_checkpoint(run_dir):
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
        for name, network in self.networks.items():
            network.load_state_dict(state["networks"][name])
            self.optimizers[name].load_state_dict(state["optimizers"][name])
        self.noise.load_state_dict(state["noise"])
        self.buffer.load_state_dict(state["buffer"])
        set_rng_state(state["random"])
        progress = state["progress"]
        for name in _COUNTERS:
            setattr(self, name, progress[name])
        self.results, self._earlier_seconds = progress["results"], progress["wall_seconds"]
        self._recent.extend(progress["recent"])
