"""Loops that are divided among threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import numba
import numpy as np
from numpy.typing import NDArray


def cores() -> int:
    """Return NUMBA_NUM_THREADS if it is set, otherwise the number of cores."""
    return int(numba.config.NUMBA_NUM_THREADS)


def in_threads(function: Callable[[int, int], None], work: NDArray[np.int64], threads: int) -> None:
    """Call ``function(first, last)`` in several threads, on ranges of items with similar sums of `work` (n,)."""
    if threads == 1:
        function(0, len(work))
        return
    done = np.cumsum(work)
    ours, *others = pairwise(
        [0, *np.searchsorted(done, done[-1] / threads * np.arange(1, threads)).tolist(), len(work)]
    )
    waiting = [_pool(os.getpid()).submit(function, *part) for part in others]
    function(*ours)
    for part in waiting:
        part.result()


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Return the thread pool of a process; a forked process needs a new pool."""
    return ThreadPoolExecutor(max(1, cores() - 1), f"openmm-exactrb-{process}")
