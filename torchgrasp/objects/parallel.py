"""The same work for many objects, in one process or several, with a progress bar."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from tqdm import tqdm

from torchgrasp.interruption import serve_parent


def run_each(
    work: Callable[[int], None], indices: Sequence[int], *, workers: int, label: str, progress: bool = True
) -> None:
    """Call `work` for each index; its results are expected on disk.

    Args:
        work: can be pickled where there are several workers, and skips what is already done.
        indices: what it is called with.
        workers: processes; one works in this process.
        label: of the bar.
        progress: show the bar.
    """
    if not indices:
        return
    workers = min(workers, len(indices))
    with tqdm(total=len(indices), desc=label, disable=None if progress else True) as bar:
        if workers > 1:
            try:
                _run_in_processes(work, indices, workers, bar)
                return
            except BrokenProcessPool:
                warnings.warn(
                    "The building processes died or could not start (a script without"
                    " 'if __name__ == \"__main__\":'?): the objects are built in this process.",
                    stacklevel=3,
                )
                bar.reset()
        for index in indices:
            work(index)
            bar.update()


def _run_in_processes(work: Callable[[int], None], indices: Sequence[int], workers: int, bar: tqdm) -> None:
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=serve_parent) as pool:
        futures = [pool.submit(work, index) for index in indices]
        try:
            for future in as_completed(futures):
                future.result()
                bar.update()
        except (KeyboardInterrupt, BrokenProcessPool):
            # The executor would wait for what they are at; they hold nothing that anybody misses.
            for process in pool._processes.values():
                process.kill()
            raise
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
