"""Which cores updates use, and how, so that another busy process costs its share of them and no more."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import nn

from torchgrasp.modules.batch_parts import batches_in_parts, goes_in_parts
from torchgrasp.processes import count_cores

# Two threads a core get more of it beside another process than one does, and cost nothing without.
_PARTS_A_CORE = 2
# Of more parts than this the threads would wait for Python's lock.
_MOST_PARTS = 8


@contextmanager
def updates_on_cores(networks: Iterable[nn.Module], device: torch.device | str = "cpu") -> Iterator[str]:
    """Let updates on `device` use the cores that torch may use; gives a line that says how.

    On a CPU a batch goes through encoders in parts, two a core (see `torchgrasp.modules.batch_parts`),
    instead of operation by operation through threads of OpenMP, which wait for each other at the end of
    each. With OMP_NUM_THREADS=1, or `torch.set_num_threads(1)`, one core does all. Where no encoder of
    the networks can be taken in parts, torch's threads stay as they are.

    Args:
        networks: that learn; none where their updates are compiled.
        device: of them.

    >>> torch.set_num_threads(1)
    >>> with updates_on_cores([]) as told:
    ...     print(told)
    Updates use one core, as torch was told: OMP_NUM_THREADS=<cores> gives it more
    """
    threads = min(torch.get_num_threads(), count_cores())
    if torch.device(device).type != "cpu":
        yield f"Updates run on {device}"
        return
    if threads == 1:
        yield "Updates use one core, as torch was told: OMP_NUM_THREADS=<cores> gives it more"
        return
    if not any(goes_in_parts(module) for network in networks for module in network.modules()):
        yield f"Updates use {threads} cores"
        return
    before, parts = torch.get_num_threads(), min(_PARTS_A_CORE * threads, _MOST_PARTS)
    torch.set_num_threads(max(1, threads // parts))
    try:
        with batches_in_parts(parts):
            yield (
                f"Updates use {threads} cores, a batch in {parts} parts side by side, which lose little "
                "beside other busy processes; OMP_NUM_THREADS=1 leaves them one core"
            )
    finally:
        torch.set_num_threads(before)
