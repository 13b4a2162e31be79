"""A lock on a folder or a file, for one process at a time."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def only_process(path: Path, *, wait: bool = False) -> Iterator[bool]:
    """Hold a lock on a folder, or on a file that is created if missing, until the block or the process ends.

    If another process holds the lock, wait for it, or raise BlockingIOError. The value is False on Windows, and on file
    systems without such locks, where nothing is locked.
    """
    if sys.platform == "win32":
        yield False
        return
    import fcntl  # noqa: TID251

    # Network file systems lock files that are opened for writing.
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            locked = True
        except BlockingIOError:
            raise BlockingIOError(
                f"another process is running in {path}: wait until it ends, or use another folder"
            ) from None
        except OSError:
            locked = False
        yield locked
    finally:
        os.close(descriptor)
