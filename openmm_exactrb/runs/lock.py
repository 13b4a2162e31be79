"""A lock on a folder, for one process at a time."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def only_process(folder: Path) -> Iterator[None]:
    """Hold a lock on a folder until the block or the process ends; raise BlockingIOError if another process holds it.

    On Windows, and on file systems without such locks, the folder is not locked.
    """
    if sys.platform == "win32":
        yield
        return
    import fcntl  # noqa: TID251

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BlockingIOError(
                f"another process is running in {folder}: wait until it ends, or use another folder"
            ) from None
        except OSError:
            pass  # some network file systems have no locks
        yield
    finally:
        os.close(descriptor)
