"""Overheating: the thermostat does not remove the heat of a step that is too long, but the run does not diverge."""

from __future__ import annotations

import math

import numpy as np

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.support.warn import warn

# A mean over so many samples, each a relaxation time of the thermostat or more after the last one, and the times at the
# begin that are left out: heat of the start is gone after a few of them.
_SAMPLES, _LEFT_OUT = 100, 20
# Part by which the mean has to be too high, and by how many standard errors.
_TOO_HOT, _ERRORS = 0.05, 4.0


class StepSizeWarning(UserWarning):
    """A step is too long for correct averages: it is near a resonance, or the run is hotter than its thermostat."""


class Overheating:
    """Monitors the temperatures of a run with a thermostat, and warns once.

    Translation and rotation of rigid bodies, and all other particles, are monitored separately, because a solute may be
    hotter than its water. kT (kJ/mol) is that of the thermostat, and relaxation (ps) the time in which it removes heat.
    """

    def __init__(self, bodies: RigidBodies, kT: float, relaxation: float) -> None:
        self._bodies, self._kT, self._relaxation = bodies, kT, relaxation
        turning, others = bodies.n_turning, bodies.translational_freedom - 3 * bodies.n_turning
        self._freedom = np.array([3 * turning, bodies.rotational_freedom, others])
        self._told, self._since = False, 0.0
        self.begin(0.0)

    def begin(self, time: float) -> None:
        """Start a mean at the time (ps) at which the state was set."""
        self._next, self._sums, self._count = time + _LEFT_OUT * self._relaxation, np.zeros(3), 0

    def see(self, time: float, state: State) -> None:
        """Sample the state at a time (ps) if a sample is due, and issue a StepSizeWarning once."""
        if self._told or time < self._next:
            return
        if not self._count:
            self._since = time
        self._next = max(self._next + self._relaxation, time)
        self._sums += self._kinetic(state)
        self._count += 1
        if self._count == _SAMPLES:
            self._judge(time - self._since)
            self._sums, self._count = np.zeros(3), 0

    def _kinetic(self, state: State) -> list[float]:
        """Return the kinetic energies of translation and rotation of rigid bodies, and of other particles."""
        bodies, rounded = self._bodies, state.rounded
        P, turning = bodies.tangent(rounded).P, bodies.n_turning
        energies = 0.5 * (P * P).sum(axis=0) / bodies.mass
        rotation = 0.5 * float((rounded.m * rounded.m / bodies.inertia.T).sum())
        return [float(energies[:turning].sum()), rotation, float(energies[turning:].sum())]

    def _judge(self, duration: float) -> None:
        names = "translation of rigid bodies", "rotation of rigid bodies", "particles outside rigid bodies"
        for name, total, freedom in zip(names, self._sums / _SAMPLES, self._freedom, strict=True):
            if not freedom or not self._kT:
                continue
            excess = 2.0 * total / (freedom * self._kT) - 1.0
            if excess > _TOO_HOT + _ERRORS * math.sqrt(2.0 / (freedom * _SAMPLES)):
                self._told = True
                warn(
                    f"the temperature of the {name} is {100.0 * excess:.0f} % above that of the thermostat, "
                    f"averaged over {duration:.3g} ps, which its friction does not explain: use a "
                    "smaller step size, or more friction",
                    StepSizeWarning,
                )
                return
