"""The same work for many objects, on every core, with a line that says where it is."""

from __future__ import annotations

import pickle
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from multiprocessing.connection import wait
from types import TracebackType
from typing import Any

import psutil
from tqdm import tqdm

from torchgrasp.errors import ObjectError
from torchgrasp.processes import HelperProcess, count_cores

_MEMORY = 1e9  # bytes that a process may need
_WORTH = 2  # objects for each process: it takes as long to start as to build one or two
_SILENT = 1.0  # seconds until the line appears
_BETWEEN = 10.0  # seconds between two states of it where there is no terminal


def run_each(
    work: Callable[[int], None],
    indices: Sequence[int],
    *,
    workers: int | None = None,
    label: str,
    name: Callable[[int], str] = str,
    progress: bool = True,
) -> None:
    """Call `work` for each index; its results are expected on disk.

    Processes are started afresh and do not run the caller's script again, so that this needs no
    ``if __name__ == "__main__":``. They end with this one. ObjectError names the object at which one dies.

    Args:
        work: can be pickled, and skips what is already done. What is of the caller's script cannot be
            found from other processes: then this one does the work.
        indices: what it is called with.
        workers: processes; None for one a core, as far as they are worth it; 1 works in this process.
        label: of the line.
        name: of the object of an index, for the line.
        progress: show the line, on standard error, where the work takes more than a second.
    """
    if workers is None:
        most = min(count_cores(), int(psutil.virtual_memory().available // _MEMORY))
        workers = min(most, len(indices) // _WORTH)
    workers = min(workers, len(indices))
    packed = pickle.dumps(work) if workers > 1 else None
    with _Line(len(indices), label, show=progress) as line:
        if packed is None or b"__main__" in packed:
            for index in indices:
                line.begin(name(index))
                work(index)
                line.end(name(index))
        else:
            _run_in_processes(packed, indices, workers, line, name)


def _run_in_processes(
    work: bytes, indices: Sequence[int], workers: int, line: _Line, name: Callable[[int], str]
) -> None:
    waiting, builders = deque(indices), [HelperProcess(work) for _ in range(workers)]
    busy: dict[Any, tuple[HelperProcess, int]] = {}

    def begin(builder: HelperProcess) -> None:
        if waiting:
            index = waiting.popleft()
            line.begin(name(index))
            builder.begin(index)
            busy[builder.pipe] = builder, index

    try:
        for builder in builders:
            begin(builder)
        while busy:
            for pipe in wait(list(busy)):
                builder, index = busy.pop(pipe)
                if (how := builder.finish()) is not None:
                    raise ObjectError(
                        f"{name(index)} could not be prepared: its process {how}. Give fewer workers= where"
                        " memory is short; otherwise remove the object."
                    )
                line.end(name(index))
                begin(builder)
    finally:
        for builder in builders:
            builder.kill()


class _Line:
    """How far the work is and what it is at, on standard error, where it takes longer than a second.

    Args:
        total: objects.
        label: stands in front.
        show: whether to show it at all.
    """

    def __init__(self, total: int, label: str, *, show: bool) -> None:
        self._total, self._label = total, label
        self._done, self._current = 0, dict[str, None]()
        self._start = time.time()
        self._ended: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._show, daemon=True) if show and total else None

    def begin(self, name: str) -> None:
        """An object is begun."""
        self._current[name] = None

    def end(self, name: str) -> None:
        """It is done."""
        self._current.pop(name, None)
        self._done += 1

    def __enter__(self) -> _Line:
        if self._thread is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if self._thread is not None:
            self._ended.put(None)
            self._thread.join()

    def _show(self) -> None:
        """Work that is done in C code, without a call to Python for a minute, has to be told of as well."""
        if self._is_over(_SILENT):
            return
        terminal = sys.stderr.isatty()
        with tqdm(total=self._total, desc=self._label, dynamic_ncols=terminal, mininterval=0) as bar:
            bar.start_t = self._start
            over = False
            while not over:
                self._refresh(bar)
                over = self._is_over(_SILENT if terminal else _BETWEEN)
            self._refresh(bar)

    def _is_over(self, seconds: float) -> bool:
        try:
            self._ended.get(timeout=seconds)
        except queue.Empty:
            return False
        return True

    def _refresh(self, bar: tqdm) -> None:
        names = list(self._current)
        bar.n = self._done
        bar.set_postfix_str(names[0] if names else "")  # the one that has taken longest
