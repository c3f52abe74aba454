"""suite=encoder: forward and backward through an encoder."""

from __future__ import annotations

from collections.abc import Callable

import torch
from network_passes import Encoder, compare_encoders, make_clouds
from omegaconf import DictConfig


def benchmark_encoder(cfg: DictConfig) -> list[dict]:
    """Forward and backward of `batch` clouds of `points` points, one encoder after the other."""
    return compare_encoders(cfg, "encoder", make_encoder_pass)


def make_encoder_pass(make: Encoder, options: dict, device: torch.device) -> tuple[Callable[[], None], int]:
    """Forward and backward of one batch, and the encoder's number of weights."""
    encoder = make(4).to(device)
    clouds = make_clouds(options["batch"], options["points"], seed=0).to(device)

    def run() -> None:
        encoder.zero_grad(set_to_none=True)
        encoder(clouds).float().square().mean().backward()

    return run, sum(p.numel() for p in encoder.parameters())
