"""suite=neighbours: an update of imitation beside other busy processes, by how it uses the cores."""

from __future__ import annotations

import multiprocessing
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

import torch
from network_passes import make_clouds
from omegaconf import DictConfig
from tensordict import TensorDict

from torchgrasp.modules import GraspActor, PointNet
from torchgrasp.objectives import PoseBCLoss
from torchgrasp.processes import count_cores
from torchgrasp.training.cores import updates_on_cores

# name -> whether updates go in parts, torch's threads (None: one a core), and OMP_WAIT_POLICY.
_WAYS: dict[str, tuple[bool, int | None, str | None]] = {
    "threads of OpenMP": (False, None, None),
    "the same, passive": (False, None, "PASSIVE"),
    "one core": (False, 1, None),
    "parts, as recipes do": (True, None, None),
}


def benchmark_neighbours(cfg: DictConfig) -> list[dict]:
    """Milliseconds quiet, beside one busy process and beside one a core, and the share of speed that is kept.

    Shares are of the first way's quiet speed: what users have who set nothing. The machine must be quiet.
    """
    rows: list[dict] = []
    for name, (parts, threads, policy) in _WAYS.items():
        with _waiting(policy), multiprocessing.get_context("spawn").Pool(1) as pool:
            seconds = pool.apply(measure_neighbours, (parts, threads, dict(cfg.neighbours)))
        rows.append({"name": name, "seconds": seconds})
        base = rows[0]["seconds"][0]
        figures = ", ".join(f"{1e3 * each:7.1f} ms (x {base / each:.2f})" for each in seconds)
        print(f"{name:22} quiet, beside one, beside one a core: {figures}", flush=True)
    return rows


@contextmanager
def _waiting(policy: str | None) -> Iterator[None]:
    """Have processes that begin meanwhile wait so at OpenMP's barriers: it is read when torch is loaded."""
    with patch.dict(os.environ, {} if policy is None else {"OMP_WAIT_POLICY": policy}):
        yield


def measure_neighbours(parts: bool, threads: int | None, options: dict) -> list[float]:
    """Mean seconds of an update beside no, one and one busy process a core."""
    torch.set_num_threads(threads or count_cores())
    update, found = _make_update(options["batch"], options["points"]), []
    with ExitStack() as stack:
        if parts:
            stack.enter_context(updates_on_cores([PointNet(4)]))
        for number in (0, 1, count_cores()):
            busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(number)]
            try:
                found.append(_time(update, options["seconds"]))
            finally:
                for each in busy:
                    each.kill()
                    each.wait()
    return found


def _make_update(batch: int, points: int) -> Callable[[], None]:
    torch.manual_seed(0)
    actor = GraspActor(PointNet)
    loss, optimizer = PoseBCLoss(actor, aux_weight=1.0), torch.optim.Adam(actor.parameters())
    goal = torch.tensor([0.0, 0, 0.1, 0, 0, 0, 1]).expand(batch, 7)
    state = {"points": make_clouds(batch, points, seed=0), "time_left": torch.rand(batch, 1)}
    data = TensorDict({**state, "expert_action": 0.02 * torch.rand(batch, 6), "goal": goal}, [batch])

    def update() -> None:
        optimizer.zero_grad(set_to_none=True)
        terms = loss(data)
        (terms["loss_bc"] + terms["loss_aux"]).backward()
        optimizer.step()

    return update


def _time(update: Callable[[], None], seconds: float) -> float:
    """Mean over so many seconds, and three updates at least, after two that warm up."""
    times = []
    while len(times) < 5 or sum(times[2:]) < seconds:
        start = time.perf_counter()
        update()
        times.append(time.perf_counter() - start)
    return statistics.mean(times[2:])
