"""Progress of a run on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress_bar(name: str, steps: int, quiet: bool) -> Iterator[Callable[[int], object]]:
    """Yield a function that counts steps in a progress bar; none is shown if tqdm is not installed."""
    try:
        from tqdm import tqdm
    except ModuleNotFoundError:
        yield lambda steps: None
        return
    pause = 0.2 if sys.stderr.isatty() else 10.0
    with tqdm(total=steps, desc=name, unit="step", mininterval=pause, delay=pause, disable=quiet) as bar:
        yield bar.update
