"""Interleaved timings of several candidates, so that other processes on the machine affect all of them equally."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

Name = TypeVar("Name")


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
