"""Progress on stderr, which needs tqdm: a bar for stages of known length, and the elapsed time of the others."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def counted(name: str, total: float, unit: str, quiet: bool) -> Iterator[Callable[[float], object]]:
    """Yield a function that advances the bar of a stage; without tqdm, the function does nothing."""
    with _bar(quiet, desc=name, total=total, unit=unit) as bar:
        yield bar.update if bar is not None else lambda done: None


@contextmanager
def waiting(name: str, quiet: bool) -> Iterator[None]:
    """Show how long a stage of unknown length has taken, unless it ends at once."""
    with _bar(quiet, desc=name, bar_format="{desc}: {elapsed}") as bar:
        if bar is None:
            yield
            return
        ended = threading.Event()

        def tick() -> None:
            while not ended.wait(bar.mininterval):
                bar.update(0)

        ticking = threading.Thread(target=tick, daemon=True)
        ticking.start()
        try:
            yield
        finally:
            ended.set()
            ticking.join()


@contextmanager
def _bar(quiet: bool, **options: Any) -> Iterator[Any]:
    """Yield a bar of tqdm, which appears only after a pause, or None without tqdm."""
    try:
        from tqdm import tqdm
    except ModuleNotFoundError:
        yield None
        return
    pause = 0.2 if sys.stderr.isatty() else 10.0
    with tqdm(**options, mininterval=pause, delay=pause, disable=quiet) as bar:
        yield None if quiet else bar
