"""Speed and memory of encoders and of whole updates, ours against the plain construction in PyTorch."""

from __future__ import annotations

import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable
from functools import partial

import torch
from omegaconf import DictConfig
from tensordict import TensorDict
from torch import Tensor, nn

from torchgrasp.modules import GraspActor, GraspCritic, PointNet, PointNet2
from torchgrasp.modules.plain_pointnet2 import PlainPointNet2
from torchgrasp.objectives import GraspTD3BCLoss, StaggeredTargetUpdate

_BOX = (0.06, 0.08, 0.10)  # metres

Encoder = Callable[[int], nn.Module]


def _plain(in_channels: int, norm: str = "none") -> PlainPointNet2:
    return PlainPointNet2(PointNet2(in_channels, norm=norm, start="first"))  # pyright: ignore[reportArgumentType]


_SMALL = partial(PointNet2, width=0.5, neighbours=(32, 16))
# name -> encoder, autocast, torch.compile. The first, what users write, and the second are the baselines.
_ENCODERS: dict[str, tuple[Encoder, bool, bool]] = {
    "plain, BatchNorm": (partial(_plain, norm="batch"), False, False),
    "plain": (_plain, False, False),
    "plain, bfloat16": (_plain, True, False),
    "plain, compiled": (_plain, False, True),
    "pointnet2": (PointNet2, False, False),
    "pointnet2, bfloat16": (PointNet2, True, False),
    "pointnet2, compiled": (PointNet2, False, True),
    "pointnet2_small": (_SMALL, False, False),
    "pointnet2_small, bfloat16": (_SMALL, True, False),
    "pointnet": (PointNet, False, False),
    "pointnet, bfloat16": (PointNet, True, False),
}


def make_clouds(batch: int, num_points: int, *, seed: int) -> Tensor:
    """(batch, num_points, 4): points on a box of 6 x 8 x 10 cm, 10 cm ahead of the hand, and a flag."""
    generator = torch.Generator().manual_seed(seed)
    size = torch.tensor(_BOX)
    points = torch.rand(batch, num_points, 3, generator=generator) * size
    side = torch.randint(3, (batch, num_points, 1), generator=generator)
    face = torch.randint(2, (batch, num_points, 1), generator=generator) * size[side]
    points = points.scatter(2, side, face) + torch.tensor([0.0, 0.0, 0.1])
    return torch.cat((points, torch.zeros(batch, num_points, 1)), dim=-1)


def benchmark_encoder(cfg: DictConfig) -> list[dict]:
    """Forward and backward of `batch` clouds of `points` points, one encoder after the other."""
    return _compare(cfg, "encoder", _encoder_pass)


def benchmark_update(cfg: DictConfig) -> list[dict]:
    """Two critic updates and one actor update after Eq. (3) and (4), targets included, by encoder."""
    return _compare(cfg, "update", _update_pass)


def _compare(cfg: DictConfig, what: str, make: Callable) -> list[dict]:
    rows: list[dict] = []
    for name in _ENCODERS:
        if name.endswith("compiled") and not cfg.clouds.compiled:
            continue
        row = _in_process(make, name, cfg)
        rows.append(row)
        row["over_batch_norm"] = rows[0]["seconds"] / row["seconds"]
        row["over_plain"] = rows[min(1, len(rows) - 1)]["seconds"] / row["seconds"]
        print(
            f"{what} {name:26} {1e3 * row['seconds']:8.1f} ms, {row['over_batch_norm']:5.1f} times as fast "
            f"as plain with BatchNorm, {row['over_plain']:5.1f} as plain; {row['megabytes']:6.0f} MB, "
            f"{row['parameters']:,} weights"
        )
    return rows


def _in_process(make: Callable, name: str, cfg: DictConfig) -> dict:
    """Measure in a process of its own, whose largest memory is then this encoder's."""
    options = {**cfg.clouds, "device": cfg.device}
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_measure, (make, name, options))


def _measure(make: Callable, name: str, options: dict) -> dict:
    torch.set_num_threads(options["threads"])
    torch.manual_seed(0)
    encoder, low, compiled = _ENCODERS[name]
    device = torch.device(options["device"])
    run, parameters = make(partial(_compiled, encoder) if compiled else encoder, options, device)
    before, times = _peak_megabytes(device), []
    for _ in range(options["repeats"] + 1):
        start = time.perf_counter()
        with torch.autocast(device.type, dtype=torch.bfloat16, enabled=low):
            run()
        if device.type == "cuda":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    return {
        "name": name,
        "seconds": statistics.median(times[1:]),
        "megabytes": _peak_megabytes(device) - before,
        "parameters": parameters,
    }


def _compiled(encoder: Encoder, in_channels: int) -> nn.Module:
    built = encoder(in_channels)
    built.compile()
    return built


def _peak_megabytes(device: torch.device) -> float:
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated() / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _encoder_pass(make: Encoder, options: dict, device: torch.device) -> tuple[Callable, int]:
    encoder = make(4).to(device)
    clouds = make_clouds(options["batch"], options["points"], seed=0).to(device)

    def run() -> None:
        encoder.zero_grad(set_to_none=True)
        encoder(clouds).float().square().mean().backward()

    return run, sum(p.numel() for p in encoder.parameters())


def _update_pass(make: Encoder, options: dict, device: torch.device) -> tuple[Callable, int]:
    loss = GraspTD3BCLoss(GraspActor(make).to(device), GraspCritic(make).to(device)).to(device)
    targets = StaggeredTargetUpdate(loss)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-4)
    data = _make_batch(options["batch"], options["points"]).to(device)

    def descend(terms: TensorDict) -> None:
        optimizer.zero_grad(set_to_none=True)
        torch.stack([value for key, value in terms.items() if str(key).startswith("loss_")]).sum().backward()
        optimizer.step()

    def run() -> None:
        for _ in range(2):
            descend(loss.critic_loss(data))
            targets.step()
        descend(loss.actor_loss(data))

    return run, sum(p.numel() for p in loss.parameters())


def _make_batch(batch: int, points: int) -> TensorDict:
    """Transitions as the replay buffer gives them, of arbitrary labels."""
    generator = torch.Generator().manual_seed(1)

    def state(seed: int) -> dict:
        time_left = torch.rand(batch, 1, generator=generator)
        return {"points": make_clouds(batch, points, seed=seed), "time_left": time_left}

    goal = torch.nn.functional.normalize(torch.randn(batch, 4, generator=generator), dim=-1)
    ends = torch.rand(batch, 1, generator=generator)
    action = 0.05 * (torch.rand(2, batch, 6, generator=generator) - 0.5)
    return TensorDict(
        {
            **state(2),
            "action": action[0],
            "expert_action": action[1],
            "goal": torch.cat((0.1 * torch.rand(batch, 3, generator=generator), goal), dim=-1),
            "next": {**state(3), "reward": (ends > 0.97).float(), "terminated": ends > 0.95},
        },
        [batch],
    )
