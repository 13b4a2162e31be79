"""How far a run is, on stderr."""

from __future__ import annotations

import sys
import time

_PAUSE, _PAUSE_IN_FILE = 0.2, 10.0  # seconds between two lines


class Progress:
    """A line that tells how far a run is, how fast, and how long it still takes.

    Parameters
    ----------
    name : str
    steps : int
    step : float
        Size of a step in ps.
    quiet : bool
        Write nothing.
    """

    def __init__(self, name: str, steps: int, step: float, quiet: bool = False) -> None:
        self._name, self._steps, self._step, self._quiet = name, steps, step, quiet
        self._tty = sys.stderr.isatty()
        self._done = self._before = 0
        self._began = self._told = time.monotonic()
        self._written = False

    def __call__(self, steps: int) -> None:
        """Take note of steps that were made; the first call says how many a checkpoint had."""
        now = time.monotonic()
        if not self._done and not self._before:
            self._before = steps
            self._began = now - 1e-9
        self._done += steps
        if not self._quiet and now - self._told >= (_PAUSE if self._tty else _PAUSE_IN_FILE):
            self._told = now
            self._write(now)

    def close(self) -> None:
        """End the line."""
        if self._written and self._tty:
            print(file=sys.stderr)

    def _write(self, now: float) -> None:
        made = self._done - self._before
        rate = made / (now - self._began)
        done, total = self._done * self._step, self._steps * self._step
        text = f"{self._name}: {done:.4g} of {total:.4g} ps"
        if made:
            left = (self._steps - self._done) / rate
            text += f", {86.4 * rate * self._step:.3g} ns/day, {_duration(left)} left"
        print(f"\r{text:<78}" if self._tty else text, end="" if self._tty else "\n", file=sys.stderr, flush=True)
        self._written = True


def _duration(seconds: float) -> str:
    minutes, hours = seconds / 60.0, seconds / 3600.0
    return f"{seconds:.0f} s" if seconds < 100 else f"{minutes:.0f} min" if minutes < 100 else f"{hours:.1f} h"
