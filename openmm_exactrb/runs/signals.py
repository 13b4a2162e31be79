"""Signals that request the end of a process."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType
from typing import Any

#: Signals that request the end of a process and can be caught.
ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Signals:
    """Record the first signal that requests the end of the process; a second signal ends the process.

    A signal that the process ignores, for example under `nohup`, stays ignored.
    """

    def __init__(self) -> None:
        self.caught = 0  #: Number of the signal, or 0.
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Signals:
        if threading.current_thread() is threading.main_thread():  # other threads cannot set handlers
            for number in ENDING:
                if signal.getsignal(number) not in (signal.SIG_IGN, None):  # None: set outside Python
                    self._before[number] = signal.signal(number, self._catch)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def _catch(self, number: int, frame: FrameType | None) -> None:
        self.caught = number
        self.__exit__()


class LostInterrupts:
    """Record a KeyboardInterrupt that Python drops in a destructor or C callback, so that `check` can raise it."""

    def __init__(self) -> None:
        self.lost = False
        self._before = sys.unraisablehook

    def __enter__(self) -> LostInterrupts:
        sys.unraisablehook = self._dropped
        return self

    def __exit__(self, *exception: object) -> None:
        sys.unraisablehook = self._before

    def check(self) -> None:
        """Raise KeyboardInterrupt if one was dropped."""
        if self.lost:
            raise KeyboardInterrupt

    def _dropped(self, unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            self.lost = True
        else:
            self._before(unraisable)
