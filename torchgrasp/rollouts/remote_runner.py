"""The actor that runs episodes on another machine of a Ray cluster.

It is sent as it stands here, since that machine may lack this module: before `run` it uses the standard
library and Ray alone, so that a machine without torchgrasp can be named.
"""

from __future__ import annotations

import os
import pickle
import sys
from typing import Any


class RemoteRunner:
    """An EpisodeRunner: begun, placed, loaded once its machine may run it, and then run.

    Args:
        path: where the one who sends it finds modules; this machine looks there last.
        runner: pickled.
    """

    def __init__(self, path: list[str], runner: bytes) -> None:
        sys.path += [each for each in path if each not in sys.path]
        self._packed = runner
        self._runner: Any = None

    def place(self) -> tuple[str, str, int]:
        """The machine's id and address, and the process."""
        import ray

        return ray.get_runtime_context().get_node_id(), ray.util.get_node_ip_address(), os.getpid()

    def load(self) -> None:
        """Unpickle the runner, where this process's modules are found."""
        import torch

        torch.set_num_threads(1)
        self._runner = pickle.loads(self._packed)

    def run(self, env: str, policy: bytes, number: int, explore: bool) -> bytes:
        """The packed answer to a `worker_pool.Task` of these."""
        from torchgrasp.rollouts.worker_pool import Task, answer

        return answer(self._runner, Task(env, policy, number, explore))
