"""Steps and time of a Context within one call of `step`."""

from __future__ import annotations

from typing import Any

import openmm
from openmm import unit

from openmm_exactrb.context import ledger


class Clock:
    """Counts the steps of a call, and has OpenMM count them.

    Parameters
    ----------
    context : openmm.Context
    integrator : openmm.CustomIntegrator
    h : float
        Size of a step in ps.

    Attributes
    ----------
    number : int
        Of the last step that was made.
    time : float
        Behind it, in ps.
    """

    def __init__(self, context: Any, integrator: openmm.CustomIntegrator, h: float) -> None:
        self._context, self._integrator, self._h = context, integrator, h
        self._begin = self.number, self.time = context.getStepCount(), context.getTime().value_in_unit(unit.picosecond)
        self._ticks = 0

    def next(self) -> None:
        """Count a step."""
        self.number, self.time = self.number + 1, self.time + self._h

    def reset(self, number: int, time: float) -> None:
        """Go back to a step."""
        self.number, self.time = number, time

    def tick(self) -> None:
        """Have OpenMM make a step of its own now, with what it does between steps."""
        self._ticks += 1
        ledger.step(self._integrator, 1)

    def stop(self) -> None:
        """Bring OpenMM's count and time up to those of the last step."""
        missing = self.number - self._begin[0] - self._ticks
        if missing > 0:
            ledger.step(self._integrator, missing)
        # OpenMM's own clock does not learn of a new step size where no computation uses dt.
        self._context.setTime(self.time)
