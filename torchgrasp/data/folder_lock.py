"""A folder that one process at a time writes to."""

from __future__ import annotations

import fcntl
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torchgrasp.data.files import writing
from torchgrasp.errors import StorageError


@contextmanager
def own_folder(path: str | Path) -> Iterator[None]:
    """Hold the folder `path`, which is there, against other processes that would own it.

    The lock is on the folder itself, so that no file is left behind; the kernel frees it when this process
    ends, however it ends. Who only reads asks nobody. Where the disk knows no locks, as some network disks,
    a warning says so and nobody is refused.

    Raises:
        StorageError: where another process, or another part of this one, owns it.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder, own_folder(folder), own_folder(folder):
    ...     pass  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    torchgrasp.errors.StorageError: ... is being written by another process: wait until that ends, ...
    """
    with writing(path):
        handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise StorageError(
            f"{path} is being written by another process: wait until that ends, or give another folder."
        ) from error
    except OSError as error:
        warnings.warn(
            f"{path} cannot be locked ({error.strerror}): see to it that no other process writes there.",
            stacklevel=3,
        )
    try:
        yield
    finally:
        os.close(handle)
