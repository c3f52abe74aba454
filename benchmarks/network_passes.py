"""Passes through networks with one encoder after the other: ours, and the plain construction in PyTorch."""

from __future__ import annotations

import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable
from functools import partial

import torch
from omegaconf import DictConfig
from torch import Tensor, nn

from torchgrasp.modules import PointNet, PointNet2
from torchgrasp.modules.plain_pointnet2 import PlainPointNet2

_BOX = (0.06, 0.08, 0.10)  # metres

Encoder = Callable[[int], nn.Module]
# From an encoder, the options of `clouds` and a device: the pass, and how many weights it trains.
MakePass = Callable[[Encoder, dict, torch.device], tuple[Callable[[], None], int]]


def _plain(in_channels: int, norm: str = "none") -> PlainPointNet2:
    return PlainPointNet2(PointNet2(in_channels, norm=norm, start="first"))  # pyright: ignore[reportArgumentType]


_SMALL = partial(PointNet2, width=0.5, neighbours=(32, 16))
# name -> encoder, autocast, torch.compile. The first, what users write, and the second are the baselines.
_ENCODERS: dict[str, tuple[Encoder, bool, bool]] = {
    "plain, BatchNorm": (partial(_plain, norm="batch"), False, False),
    "plain": (_plain, False, False),
    "plain, bfloat16": (_plain, True, False),
    "plain, BatchNorm, compiled": (partial(_plain, norm="batch"), False, True),
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


def compare_encoders(cfg: DictConfig, what: str, make: MakePass) -> list[dict]:
    """Time, memory and size of the pass that `make` builds, one encoder after the other."""
    rows: list[dict] = []
    for name in _ENCODERS:
        _, low, compiled = _ENCODERS[name]
        if (compiled and not cfg.clouds.compiled) or (low and not cfg.clouds.bfloat16):
            continue
        row = _measure_alone(make, name, cfg)
        rows.append(row)
        row["over_batch_norm"] = rows[0]["seconds"] / row["seconds"]
        row["over_plain"] = rows[min(1, len(rows) - 1)]["seconds"] / row["seconds"]
        print(
            f"{what} {name:26} {1e3 * row['seconds']:8.1f} ms, {row['over_batch_norm']:5.1f} times as fast "
            f"as plain with BatchNorm, {row['over_plain']:5.1f} as plain; {row['megabytes']:6.0f} MB, "
            f"{row['parameters']:,} weights"
        )
    return rows


def _measure_alone(make: MakePass, name: str, cfg: DictConfig) -> dict:
    """Measure in a process of its own on a CPU, whose largest memory is then this encoder's."""
    options = {**cfg.clouds, "device": cfg.device}
    if torch.device(cfg.device).type == "cuda":  # its memory can be counted anew
        return measure_pass(make, name, options)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(measure_pass, (make, name, options))


def measure_pass(make: MakePass, name: str, options: dict) -> dict:
    """Median seconds, megabytes and weights of a pass with the encoder `name`, after one that warms up."""
    torch.set_num_threads(options["threads"])
    torch.manual_seed(0)
    encoder, low, compiled = _ENCODERS[name]
    device = torch.device(options["device"])
    if device.type == "cuda":
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    run, parameters = make(partial(_compiled, encoder) if compiled else encoder, options, device)
    before, times = peak_megabytes(device), []
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
        "megabytes": peak_megabytes(device) - before,
        "parameters": parameters,
    }


def _compiled(encoder: Encoder, in_channels: int) -> nn.Module:
    built = encoder(in_channels)
    built.compile()
    return built


def peak_megabytes(device: torch.device) -> float:
    """The most that was allocated on a GPU since its peak was reset, or resident in this process so far."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated() / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
