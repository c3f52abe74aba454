"""TorchRL's pendulum, swung up by the loss, the sampler and the target update of this library.

python recipes/pendulum.py               # five seeds, half a minute to a minute each on one core
"""

from __future__ import annotations

import json
import time

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.optim.lr_scheduler import LambdaLR
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import PendulumEnv
from torchrl.envs.utils import step_mdp
from torchrl.modules import MLP

from torchgrasp.config import Pendulum, build, check_values, one_line_errors, recipe_main
from torchgrasp.data import MixtureSampler
from torchgrasp.data.files import try_folder
from torchgrasp.objectives import StaggeredTargetUpdate
from torchgrasp.runs import hardware, make_run_dir, seed_everything, versions
from torchgrasp.training import step_schedule

_STATE = ("th", "thdot")


class PendulumNet(nn.Module):
    """An MLP on the angle (*), its rate (*) and, in a critic, the torque (*, 1); writes one number (*, 1)."""

    def __init__(self, hidden: int, *, num_inputs: int, bound: float | None = None) -> None:
        super().__init__()
        self.mlp = MLP(num_inputs, 1, num_cells=[hidden, hidden], activation_class=nn.ReLU)
        self.bound = bound

    def forward(self, angle: Tensor, rate: Tensor, *torque: Tensor) -> Tensor:
        """Cosine and sine stand for the angle, which jumps at half a turn."""
        out = self.mlp(torch.stack((angle.cos(), angle.sin(), rate / 8.0), dim=-1), *torque)
        return out if self.bound is None else self.bound * out.tanh()


def make_networks(hidden: int) -> tuple[TensorDictModule, list[TensorDictModule]]:
    """An actor of torques up to 2, and two ordinary critics."""
    actor = TensorDictModule(PendulumNet(hidden, num_inputs=3, bound=2.0), [*_STATE], ["action"])
    reads, writes = [*_STATE, "action"], ["state_action_value"]
    critics = [TensorDictModule(PendulumNet(hidden, num_inputs=4), [*reads], [*writes]) for _ in range(2)]
    return actor, critics


def start(env: PendulumEnv, count: int) -> TensorDictBase:
    """As many pendulums at random angles."""
    return env.reset(env.gen_params(batch_size=[count]), set_state=False)


@torch.no_grad()
def mean_return(env: PendulumEnv, actor: TensorDictModule, cfg: DictConfig) -> float:
    """Mean undiscounted return of an episode without exploration noise."""
    now = start(env, cfg.evaluation_episodes)
    steps = env.rollout(cfg.horizon, actor, tensordict=now, auto_reset=False, break_when_any_done=False)
    return steps["next", "reward"].sum(dim=(-1, -2)).mean().item()


@torch.no_grad()
def explore(actor: TensorDictModule, now: TensorDictBase, noise: float | None) -> TensorDictBase:
    """Torques of the actor with normal noise, or, without a size of noise, torques by chance."""
    action = actor(now).get("action")
    action = 4 * torch.rand_like(action) - 2 if noise is None else action + noise * torch.randn_like(action)
    return now.set("action", action.clamp(-2, 2))


def make_buffer(cfg: DictConfig) -> TensorDictReplayBuffer:
    """An ordinary buffer with room for all, whose batches mix both sources."""
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(cfg.num_envs * (cfg.random_steps + cfg.online_steps)),
        sampler=MixtureSampler({"random": 1.0 - cfg.online_fraction, "online": cfg.online_fraction}),
        batch_size=cfg.batch_size,
    )


def store(buffer: TensorDictReplayBuffer, steps: TensorDictBase, source: int) -> None:
    """Add transitions (B), and where they come from."""
    rows = steps.select(*_STATE, "action", *(("next", key) for key in (*_STATE, "reward", "terminated")))
    buffer.extend(rows.set("source", torch.full((len(rows), 1), source)))


def train(cfg: DictConfig, seed: int) -> dict[str, float]:
    """Learn from one seed; the returns before and after, and the seconds between."""
    seed_everything(seed)
    env = PendulumEnv(seed=seed)
    actor, critics = make_networks(cfg.hidden)
    loss = build(cfg.loss, actor, critics).make_value_estimator(gamma=cfg.gamma)
    targets = StaggeredTargetUpdate(loss, tau=cfg.tau, period=cfg.period)
    params = (loss.critic_network_params, loss.actor_network_params)
    adam_critic, adam_actor = (torch.optim.Adam(p.parameters(), lr=cfg.learning_rate) for p in params)
    milestones = dict.fromkeys(round(m * cfg.online_steps) for m in cfg.milestones)  # may round to one
    rate = step_schedule([*milestones], gamma=cfg.decay)
    schedulers = [LambdaLR(adam, rate) for adam in (adam_critic, adam_actor)]
    buffer = make_buffer(cfg)
    before, started, critic_updates = mean_return(env, actor, cfg), time.monotonic(), 0

    now = start(env, cfg.num_envs)
    for step in range(cfg.random_steps + cfg.online_steps):
        online = step >= cfg.random_steps
        stepped = env.step(explore(actor, now, cfg.exploration if online else None))
        store(buffer, stepped, source=int(online))
        now = start(env, cfg.num_envs) if (step + 1) % cfg.horizon == 0 else step_mdp(stepped)
        for _ in range(online * cfg.updates):
            batch = buffer.sample()
            descend(adam_critic, loss.critic_loss(batch))
            targets.step()
            critic_updates += 1
            if critic_updates % cfg.policy_delay == 0:
                descend(adam_actor, loss.actor_loss(batch))
        for scheduler in schedulers:
            if online:
                scheduler.step()
    seconds = time.monotonic() - started
    return {"before": before, "after": mean_return(env, actor, cfg), "seconds": seconds}


def descend(optimizer: torch.optim.Optimizer, terms: TensorDictBase) -> None:
    """One step down the sum of the loss terms."""
    optimizer.zero_grad()
    torch.stack([value for key, value in terms.items() if str(key).startswith("loss_")]).sum().backward()
    optimizer.step()


@recipe_main(config_name="pendulum")
@one_line_errors()
def main(cfg: DictConfig) -> None:
    """Learn from each seed, and print and write the table."""
    check_values(cfg, Pendulum)
    try_folder(str(cfg.output_dir))
    rows = {}
    print("seed  return before  return after  seconds", flush=True)
    for seed in [cfg.seeds] if isinstance(cfg.seeds, int) else cfg.seeds:
        rows[seed] = row = train(cfg, seed)
        print(f"{seed:4d}  {row['before']:13.0f}  {row['after']:12.0f}  {row['seconds']:7.0f}", flush=True)
    result = {"rows": rows, "versions": versions(), "hardware": hardware()}
    make_run_dir("pendulum", root=str(cfg.output_dir), files={"pendulum.json": json.dumps(result, indent=2)})


if __name__ == "__main__":
    main()
