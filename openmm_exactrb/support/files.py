"""Files that are written completely or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any


@contextlib.contextmanager
def written_whole(file: str | os.PathLike[str], mode: str = "w", part: str = ".part") -> Iterator[IO[Any]]:
    """Open a file that is created or replaced only when its content is complete and on disk.

    Parameters
    ----------
    file : str or path
    mode : str, optional
        "w" or "wb".
    part : str, optional
        Suffix of the name until the file is complete. Processes that may write the same file need different suffixes.

    Yields
    ------
    file object

    Raises
    ------
    OSError
        If the file cannot be written; an existing file is unchanged.
    """
    path = Path(file)
    draft = path.with_name(path.name + part)
    try:
        with draft.open(mode) as out:
            yield out
            out.flush()
            os.fsync(out.fileno())
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    sync(path.parent)


def sync(path: Path) -> None:
    """Flush a file or folder to disk."""
    if path.is_dir() and os.name != "posix":
        return
    descriptor = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
