"""suite=learner: updates as they are, compiled and as CUDA graphs, and batches drawn ahead for them."""

from __future__ import annotations

import functools
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from composition import compose_config
from network_passes import make_clouds
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase

from torchgrasp.config import make_actor_critic, make_experience, training_config
from torchgrasp.data import DemonstrationSource, append_shard
from torchgrasp.errors import ConfigError
from torchgrasp.geometry import ACTION_BOUND, gripper_control_points
from torchgrasp.runs import seed_everything
from torchgrasp.training import ActorCriticLearner, Experience

# name -> values of `compile` and `cudagraphs`.
_WAYS: dict[str, tuple[str | None, bool]] = {
    "plain": (None, False),
    "cudagraphs": (None, True),
    "compiled": ("default", False),
    "compiled, cudagraphs": ("default", True),
    "reduce-overhead": ("reduce-overhead", False),
}
_HORIZON = 30
# Updates of each kind whose results are compared; four run before a graph is recorded.
_IMITATED, _LEARNED = 8, 20
# Lines of a profile.
_KERNELS = 24


def benchmark_learner(cfg: DictConfig) -> list[dict]:
    """A row for each way and experiment: milliseconds an update, of 20 + 10 updates, and what differs."""
    if unknown := set(cfg.learner.ways) - set(_WAYS):
        raise ConfigError(f"learner.ways={sorted(unknown)} are unknown: give some of {', '.join(_WAYS)}.")
    rows, references = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for name in cfg.learner.experiments:
            _report_drawing(name, _Setting(cfg, name, "plain", Path(folder)))
        for way in cfg.learner.ways:
            for name in cfg.learner.experiments:
                row = {"way": way, "experiment": name}
                try:
                    row |= _measure(cfg, name, way, Path(folder), references)
                except Exception as error:  # the others are worth having all the same
                    row["error"] = f"{type(error).__name__}: {error}"
                rows.append(row)
                print(_tell(row), flush=True)
    return rows


class _Setting:
    """A learner of an experiment and a buffer with episodes of arbitrary clouds and labels."""

    def __init__(self, cfg: DictConfig, name: str, way: str, folder: Path) -> None:
        mode, graphs = _WAYS[way]
        overrides = [f"experiment={name}", *cfg.learner.overrides, f"device={cfg.device}"]
        overrides += [f"compile={mode or 'null'}", f"cudagraphs={str(graphs).lower()}"]
        overrides += ["replay.online_capacity=20000", f"demonstrations.steps={cfg.learner.transitions}"]
        self.cfg = training_config(compose_config("td3_bc", overrides), "td3_bc")
        self.device = torch.device(cfg.device)
        seed_everything(cfg.seed)
        self.learner: ActorCriticLearner = make_actor_critic(self.cfg)
        self.learner.set_rate(self.cfg.online.learning_rate)
        self.experience = self._fill(folder / name)

    def _fill(self, folder: Path) -> Experience:
        points = self.cfg.num_points
        sizes = {"time_left": (1,), "table_plane": (4,), "wrist_angle": (1,)}
        shapes = {"points": (points + len(gripper_control_points()), 4), **sizes}
        experience = make_experience(self.cfg, self.learner.networks, shapes, own="online")
        episodes = _make_episodes(-(-self.cfg.demonstrations.steps // _HORIZON), points)
        if not folder.exists():
            names = ["box"] * len(episodes)
            append_shard(
                folder,
                episodes,
                objects=names,
                seeds=range(len(episodes)),
                index=0,
                codec=experience.codec,
            )
        experience.make_buffer([DemonstrationSource("expert", folder, "all")])
        experience.load_demonstrations()
        for episode in episodes:
            experience.add(episode)
        experience.draw_all()
        return experience

    def batches(self, count: int) -> Iterator[TensorDictBase]:
        """As a run draws them."""
        return self.experience.batches(count, self.cfg.replay.batch_size)


@functools.cache
def _make_episodes(count: int, num_points: int) -> list[TensorDict]:
    """Whole episodes (T) of clouds with the gripper's points, all labelled, half of them successful."""
    episodes = []
    generator = torch.Generator().manual_seed(0)
    tail = torch.cat((gripper_control_points(), torch.ones(6, 1)), dim=-1).expand(_HORIZON + 1, -1, -1)
    bound = torch.tensor(ACTION_BOUND)
    last = torch.arange(_HORIZON)[:, None] == _HORIZON - 1
    true = torch.ones(_HORIZON, 1, dtype=torch.bool)
    for number in range(count):
        cloud = torch.cat((make_clouds(_HORIZON + 1, num_points, seed=number), tail), dim=-2)
        noise = torch.randn(_HORIZON + 1, 7, generator=generator)
        state = {
            "points": cloud,
            "time_left": 1.0 - torch.arange(_HORIZON + 1.0)[:, None] / _HORIZON,
            "table_plane": torch.nn.functional.normalize(noise[:, :4], dim=-1),
            "wrist_angle": noise[:, 4:5],
            "goal": torch.cat((0.1 * noise[:, :3], torch.nn.functional.normalize(noise[:, 3:], dim=-1)), -1),
        }
        actions = bound * (2.0 * torch.rand(2, _HORIZON, 6, generator=generator) - 1.0)
        flags = {"has_expert": true, "has_goal": true, "perturbed": ~true}
        ends = {"done": last, "terminated": last, "reward": (last & bool(number % 2)).float()}
        steps = {key: value[:-1] for key, value in state.items()}
        steps |= {"action": actions[0], "expert_action": actions[1], **flags}
        following = {key: value[1:] for key, value in state.items()}
        episodes.append(TensorDict({**steps, "next": {**following, **ends, "has_goal": true}}, [_HORIZON]))
    return episodes


def _measure(cfg: DictConfig, name: str, way: str, folder: Path, references: dict) -> dict:
    setting = _Setting(cfg, name, way, folder)
    device, repeats = setting.device, cfg.learner.repeats
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats()
    batches = list(setting.batches(_LEARNED))
    row: dict[str, Any] = {}
    torch.manual_seed(cfg.seed + 1)
    found: list[dict[str, float]] = []
    row["first_seconds"] = measure_seconds(lambda: found.extend(_learn(setting.learner, batches)), device, 1)
    found.append({"weights": _checksum(setting.learner)})
    row["differs"] = _compare(found, references.setdefault(name, found))
    learner, batch = setting.learner, batches[0]
    kinds = list_updates(learner, batch)
    for kind, update in kinds.items():
        row[f"{kind}_ms"] = 1e3 * measure_seconds(update, device, repeats)
    row["iteration_ms"] = 1e3 * min(measure_seconds(lambda: _iterate(setting), device, 1) for _ in range(3))
    if cfg.learner.profile and device.type == "cuda" and way in cfg.learner.profile:
        print(_profile(kinds["critic"], kinds["actor"]), flush=True)
    if device.type == "cuda":
        row["megabytes"] = torch.cuda.max_memory_reserved() / 2**20
    return row


def list_updates(learner: ActorCriticLearner, batch: TensorDictBase) -> dict[str, Callable[[], None]]:
    """An update of each kind on the batch, by name."""
    fresh = batch.exclude("td_error")
    return {
        "imitation": lambda: learner.imitate(fresh),
        "critic": lambda: learner.update_critic(fresh.copy()),
        "actor": lambda: learner.update_actor(batch),
    }


def _learn(learner: ActorCriticLearner, batches: list[TensorDictBase]) -> Iterator[dict[str, float]]:
    """The terms of each of some updates of every kind, one after the other."""
    for batch in batches[:_IMITATED]:
        learner.imitate(batch.copy())
        yield learner.fetch_terms()
    learner.copy_to_targets()
    for batch in batches:
        learner.update_critic(batch)
        yield {**learner.fetch_terms(), "errors": batch["td_error"].double().mean().item()}
        if learner.actor_is_due:
            learner.update_actor(batch)
            yield learner.fetch_terms()


def _checksum(learner: ActorCriticLearner) -> float:
    """Length of all weights and targets as one vector."""
    parameters = [*learner.loss.parameters(), *learner.loss.buffers()]
    return float(torch.stack([each.detach().double().square().sum() for each in parameters]).sum().sqrt())


def _compare(found: list[dict[str, float]], expected: list[dict[str, float]]) -> dict[str, float]:
    """Largest differences of terms, relative to their largest values: of the first updates and of all."""
    worst = {"early": 0.0, "all": 0.0}
    scale: dict[str, float] = {}
    for terms in expected:
        for key, value in terms.items():
            scale[key] = max(scale.get(key, 0.0), abs(value))
    for number, (terms, others) in enumerate(zip(found, expected, strict=True)):
        for key, value in terms.items():
            difference = abs(value - others[key]) / max(scale[key], 1e-12)
            worst["all"] = max(worst["all"], difference)
            worst["early"] = max(worst["early"], difference if number < _IMITATED else 0.0)
    return worst


def _iterate(setting: _Setting) -> None:
    """An iteration of Sec. 6.4: 20 critic and 10 actor updates on batches that are drawn meanwhile."""
    learner = setting.learner
    for batch in setting.batches(_LEARNED):
        learner.update_critic(batch)
        if learner.actor_is_due:
            learner.update_actor(batch)
    learner.fetch_terms()


def measure_seconds(function: Callable[[], object], device: torch.device, repeats: int) -> float:
    """Mean seconds of a call; a GPU has done its part."""
    _wait(device)
    start = time.perf_counter()
    for _ in range(repeats):
        function()
    _wait(device)
    return (time.perf_counter() - start) / repeats


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize()


def _report_drawing(name: str, setting: _Setting) -> None:
    """Milliseconds a batch: drawn and moved at once, its rows alone, and handed out by the thread."""
    experience, device, size = setting.experience, setting.device, setting.cfg.replay.batch_size
    for _ in range(3):
        rows = experience.buffer.draw_rows(size).to(device)
    found = {
        "sample": measure_seconds(lambda: experience.sample(size), device, 20),
        "draw_rows": measure_seconds(lambda: experience.buffer.draw_rows(size), device, 20),
        "decode_rows here": measure_seconds(lambda: experience.buffer.decode_rows(rows.copy()), device, 20),
        "batches": measure_seconds(lambda: [None for _ in setting.batches(40)], device, 1) / 40,
    }
    figures = ", ".join(f"{key} {1e3 * value:.2f}" for key, value in found.items())
    print(f"drawing {name}, ms a batch of {size}: {figures}", flush=True)


def _profile(*updates: Callable[[], object]) -> str:
    """Where a GPU's time goes in one update each."""
    from torch.profiler import ProfilerActivity, profile

    with profile(activities=[ProfilerActivity.CUDA]) as profiled:
        for update in updates:
            update()
        torch.cuda.synchronize()
    kernels = sorted(profiled.key_averages(), key=lambda each: -each.self_device_time_total)
    total = sum(each.self_device_time_total for each in kernels)
    lines = [f"  {1e-3 * total:9.3f} ms in {sum(each.count for each in kernels)} kernels"]
    for each in kernels[:_KERNELS]:
        lines.append(f"  {1e-3 * each.self_device_time_total:9.3f} ms {each.count:5d} times {each.key[:120]}")
    return "\n".join(lines)


def _tell(row: dict) -> str:
    head = f"learner {row['experiment']:8} {row['way']:22}"
    if "error" in row:
        return f"{head} failed: {row['error']}"
    kinds = ", ".join(f"{kind} {row[f'{kind}_ms']:.1f}" for kind in ("imitation", "critic", "actor"))
    differs = ", ".join(f"{name} {value:.1e}" for name, value in row["differs"].items())
    return (
        f"{head} ms: {kinds}; 20 + 10 updates {row['iteration_ms']:.0f}; first {row['first_seconds']:.1f} s; "
        f"differs {differs}; {row.get('megabytes', 0):.0f} MB"
    )
