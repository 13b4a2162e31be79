"""Steps and time of a Context within one call of `step`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import openmm
from openmm import unit

from openmm_exactrb.context import ledger
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.state import State


class Clock:
    """Counts the steps of a call, and has the Context know them: some forces look at its time or its number of steps.

    Time goes on with the drifts. A force that depends on it so keeps a scheme's order, as if time were a coordinate.

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
        self.number, self.time = context.getStepCount(), context.getTime().value_in_unit(unit.picosecond)
        self._drifted = 0.0  # ps since the last step

    def along(self, drift: Flow[State]) -> Flow[State]:
        """Return a drift during which the time of the Context goes on."""

        def flow(state: State, tau: float) -> State:
            state = drift(state, tau)
            self._drifted += tau
            self._context.setTime(self.time + self._drifted)
            return state

        return flow

    def at_time(self, potential: Callable[[State], float]) -> Callable[[State, float], float]:
        """Return a function of a state and a time (ps) from a potential energy at the present one."""

        def earlier(state: State, time: float) -> float:
            self._context.setTime(time)
            try:
                return potential(state)
            finally:
                self._context.setTime(self.time + self._drifted)

        return earlier

    def next(self) -> None:
        """Count a step."""
        self.reset(self.number + 1, self.time + self._h)

    def reset(self, number: int, time: float) -> None:
        """Be at the end of a step."""
        self.number, self.time, self._drifted = number, time, 0.0
        self._tell(number)

    def tick(self) -> None:
        """Have OpenMM make a step of its own now, with what it does between steps."""
        self._tell(self.number - 1)
        ledger.step(self._integrator, 1)
        self._tell(self.number)

    def _tell(self, number: int) -> None:
        # OpenMM's own clock does not learn of a new step size where no computation uses dt.
        openmm.Context.setStepCount(self._context, number)  # not the method that the session watches
        self._context.setTime(self.time)
