"""Draws made ahead by a thread, in the order and with the numbers that they would have without it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

import torch
from torch import Tensor

T = TypeVar("T")


class DrawnAhead(Generic[T]):
    """An iterator over `count` draws, of which a thread has up to `depth` ready.

    Whatever changes what is drawn, or saves the generator, comes after `pause`: draws that nobody has taken
    are given up, and the generator goes back to where it was before them, so that they are made again.

    Args:
        draw: what is called for each; it draws from `generator` alone.
        generator: of the draws.
        count: how many there are.
        depth: how many are kept ready.

    >>> generator = torch.Generator().manual_seed(0)
    >>> ahead = DrawnAhead(lambda: int(torch.randint(9, (), generator=generator)), generator, count=3)
    >>> first = next(ahead)
    >>> ahead.pause()
    >>> expected = torch.randint(9, (3,), generator=torch.Generator().manual_seed(0)).tolist()
    >>> [first, *ahead] == expected
    True
    """

    def __init__(
        self, draw: Callable[[], T], generator: torch.Generator, *, count: int, depth: int = 2
    ) -> None:
        self._draw, self._generator, self._left, self._depth = draw, generator, count, depth
        # Each draw, or what went wrong with it, beside the generator's state before it.
        self._ready: deque[tuple[Tensor, T | BaseException]] = deque()
        self._changed = threading.Condition()
        self._stopped = False
        self._thread: threading.Thread | None = None

    def __iter__(self) -> DrawnAhead[T]:
        return self

    def __next__(self) -> T:
        if not self._left:
            self.pause()
            raise StopIteration
        if self._thread is None:
            self._stopped = False
            self._thread = threading.Thread(target=self._run, args=(self._left,), daemon=True)
            self._thread.start()
        with self._changed:
            self._changed.wait_for(lambda: self._ready)
            _, drawn = self._ready.popleft()
            self._changed.notify_all()
        if isinstance(drawn, BaseException):
            self.close()
            raise drawn
        self._left -= 1
        return drawn

    def pause(self) -> None:
        """Give up what nobody has taken; the next draw is made anew, as if none had been made ahead."""
        if self._thread is None:
            return
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        self._thread.join()
        self._thread = None
        if self._ready:
            self._generator.set_state(self._ready[0][0])
            self._ready.clear()

    def close(self) -> None:
        """Pause, and end the iteration."""
        self.pause()
        self._left = 0

    def _run(self, count: int) -> None:
        for _ in range(count):
            with self._changed:
                self._changed.wait_for(lambda: self._stopped or len(self._ready) < self._depth)
                if self._stopped:
                    return
            before = self._generator.get_state()
            try:
                drawn: T | BaseException = self._draw()
            except BaseException as error:
                drawn = error
            with self._changed:
                self._ready.append((before, drawn))
                self._changed.notify_all()
            if isinstance(drawn, BaseException):
                return
