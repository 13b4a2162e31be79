"""Interleaved timings of several candidates, so that other processes on the machine affect all of them equally."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

Name = TypeVar("Name")
#: The columns of a median and its quartiles in records.
QUARTILES = "lower_quartile", "median", "upper_quartile"


def on_one_core() -> None:
    """Stay on one core: the CPU platform hands its work to a thread, which takes longer from one core to another."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # noqa: TID251


def timed(run: Callable[[], Any], clock: Callable[[], float] = time.process_time) -> float:
    """Return the seconds that a call takes."""
    begun = clock()
    run()
    return clock() - begun


def in_turns(
    runs: Mapping[Name, Callable[[], Any]], rounds: int, clock: Callable[[], float] = time.process_time
) -> dict[Name, list[float]]:
    """Return the seconds of each in each of the rounds, of which every other one goes backwards."""
    times: dict[Name, list[float]] = {name: [] for name in runs}
    for k in range(rounds):
        for name in list(runs)[:: -1 if k % 2 else 1]:
            times[name].append(timed(runs[name], clock))
    return times


def quartiles(values: Any) -> dict[str, str]:
    """Return the columns of the median and the quartiles."""
    found = np.percentile(np.array(values), (25, 50, 75))
    return dict(zip(QUARTILES, (f"{x:.3g}" for x in found), strict=True))
