"""Everything a training run changes, so that one checkpoint holds it all."""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from tensordict import TensorDictBase

from torchgrasp import keys
from torchgrasp.data import MixtureReplayBuffer, estimate_bytes, open_demonstrations
from torchgrasp.objectives import PoseBCLoss, StaggeredTargetUpdate
from torchgrasp.training import (
    cosine_schedule,
    get_rng_state,
    has_checkpoint,
    load_checkpoint,
    save_checkpoint,
    seed_everything,
    set_rng_state,
    step_schedule,
)

_RECENT_EPISODES = 200


class Learner:
    """Actor, critic, losses, optimizers, replay buffer and counters of one run.

    Args:
        cfg: the recipe's configuration.
    """

    def __init__(self, cfg: DictConfig) -> None:
        seed_everything(cfg.seed)
        self.cfg = cfg
        self.actor = instantiate(cfg.model.actor).to(cfg.device)
        self.critic = instantiate(cfg.model.critic).to(cfg.device)
        self.loss = instantiate(cfg.loss, self.actor, self.critic).to(cfg.device)
        self.loss.make_value_estimator(gamma=cfg.online.gamma)
        self.targets = StaggeredTargetUpdate(self.loss, tau=cfg.online.tau, period=cfg.online.period)
        self.imitation = PoseBCLoss(self.actor, aux_weight=cfg.pretrain.aux_weight)
        self.optimizers = {
            "actor": torch.optim.Adam(self.actor.parameters()),
            "critic": torch.optim.Adam(self.critic.parameters()),
        }
        self.noise = instantiate(cfg.collector.noise).to(cfg.device)
        self.expert_start = instantiate(cfg.collector.expert_start)
        self.buffer = _make_buffer(cfg)
        self._imitation_rate = cosine_schedule(
            cfg.pretrain.steps, warmup_steps=min(200, cfg.pretrain.steps // 10)
        )
        self._online_rate = step_schedule(
            [round(1000 * m) for m in cfg.online.milestones], gamma=cfg.online.decay
        )
        self.pretrain_steps = self.gradient_steps = self.env_steps = self.iterations = 0
        self.results: dict = {}
        self._recent: deque[bool] = deque(maxlen=_RECENT_EPISODES)
        self._started, self._earlier_seconds = time.monotonic(), 0.0

    @property
    def wall_seconds(self) -> float:
        """Seconds spent on this run, those before a resume included."""
        return self._earlier_seconds + time.monotonic() - self._started

    def load_demonstrations(self, path: Path) -> None:
        """Fill D_expert with the successful episodes below `path`."""
        for rows in open_demonstrations(path).iterate_rows():
            self.buffer.extend_rows(rows[rows[keys.EPISODE_SUCCESS].squeeze(-1)], source="expert")
        size = estimate_bytes(
            sum(self.buffer.num_rows().values()), num_points=self.cfg.transforms.sample.num_points
        )
        print(f"{self.buffer.num_rows()['expert']} expert steps, {size / 1e6:.0f} MB in memory")

    def imitate(self, batch: TensorDictBase) -> dict[str, float]:
        """One update of imitation and goal prediction, of the critic too where configured."""
        rate = self.cfg.pretrain.learning_rate * self._imitation_rate(self.pretrain_steps)
        self._set_rate("actor", rate)
        self._set_rate("critic", rate)
        metrics = self._descend("actor", self.imitation(batch))
        if self.cfg.pretrain.critic:
            metrics |= self.update_critic(batch)
        else:
            self.gradient_steps += 1
        self.pretrain_steps += 1
        if self.pretrain_steps == self.cfg.pretrain.steps:
            self.set_rates(0.0)
        return metrics

    def update_critic(self, batch: TensorDictBase) -> dict[str, float]:
        """One update after Eq. (3), and the targets' step."""
        metrics = self._descend("critic", self.loss.critic_loss(batch))
        self.targets.step()
        self.gradient_steps += 1
        return metrics

    def update_actor(self, batch: TensorDictBase) -> dict[str, float]:
        """One update after Eq. (4)."""
        return self._descend("actor", self.loss.actor_loss(batch))

    def _descend(self, name: str, terms: TensorDictBase) -> dict[str, float]:
        optimizer = self.optimizers[name]
        optimizer.zero_grad(set_to_none=True)
        losses = [value for key, value in terms.items() if str(key).startswith("loss_")]
        torch.stack(losses).sum().backward()
        optimizer.step()
        return {f"{name}/{key}": float(value) for key, value in terms.items()}

    def set_rates(self, progress: float) -> None:
        """The piecewise schedule of the online phase (Sec. 6.4); `progress` in [0, 1]."""
        for name in self.optimizers:
            self._set_rate(name, self.cfg.online.learning_rate * self._online_rate(round(1000 * progress)))

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

    def resume(self, run_dir: Path) -> bool:
        """Take up the checkpoint of `run_dir`; False where it has none yet."""
        if not has_checkpoint(run_dir / "checkpoint"):
            return False
        state = load_checkpoint(run_dir / "checkpoint")
        self.loss.load_state_dict(state["loss"])
        self.targets.load_state_dict(state["targets"])
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
        return True


_COUNTERS = ("pretrain_steps", "gradient_steps", "env_steps", "iterations")


def _make_buffer(cfg: DictConfig) -> MixtureReplayBuffer:
    """D_expert and the learner's own transitions, mixed by `replay.online_fraction`."""
    share = cfg.replay.online_fraction
    return MixtureReplayBuffer(
        {"online": cfg.replay.online_capacity, "expert": 2 * cfg.demonstrations.steps},
        {"online": share, "expert": 1 - share},
        batch_size=cfg.replay.batch_size,
        seed=cfg.seed,
        num_points=cfg.transforms.sample.num_points,
        transform=instantiate(cfg.replay.augment),
    )
