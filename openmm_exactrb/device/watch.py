"""Divergence check of the device: energy that no force supplied, looked for at the end of a call."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context import arrays
from openmm_exactrb.context.updates import conserve_energy
from openmm_exactrb.mechanics.divergence import GROWN, gained

Array = NDArray[np.float64]


class Snapshot(NamedTuple):
    """A Context before a call: positions (nm), velocities (nm/ps), box, time and step count."""

    x: Array
    v: Array
    box: Any
    time: Any
    step: int


class Watch:
    """Compares the energies before and after a call, if the kinetic energy says that something may be wrong.

    Parameters
    ----------
    system : openmm.System
        With forces that may do work, nothing is compared.
    freedom : int
        Degrees of freedom of the bodies.

    Attributes
    ----------
    asked : bool
        Whether a jump of the total energy is an error.
    """

    def __init__(self, system: openmm.System, freedom: int) -> None:
        self._masses = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])
        self._conserves = conserve_energy(system)
        self._freedom, self._largest, self.asked = freedom, 0.0, True

    def grown(self, then: Array, now: Array) -> bool:
        """Return whether the kinetic energy of velocities after a call is far above all those before calls."""
        self._largest = max(self._largest, self._kinetic(then))
        return self.asked and self._conserves and self._kinetic(now) > GROWN * self._largest

    def gained(self, context: Any, groups: int, then: Snapshot, kT: float) -> str | None:
        """Return by how much the total energy rose in a call, if that was integration error, or None.

        The Context is moved to the positions before the call and back. A thermostat at kT (kJ/mol) accounts for kinetic
        energies up to twice their canonical mean, and 20 kT more for systems of a few bodies.
        """
        now = context.getState(positions=True, velocities=True)
        kinetic, before = self._kinetic(arrays.velocities(now)), self._kinetic(then.v)
        if kinetic <= GROWN * kT * (self._freedom + 20):
            return None
        potential = _potential(context, groups)
        _move(context, then.x, then.box)
        potential_before = _potential(context, groups)
        _move(context, arrays.positions(now), now.getPeriodicBoxVectors())
        return gained(self._freedom, (before, before + potential_before), (kinetic, kinetic + potential))

    def _kinetic(self, v: Array) -> float:
        return 0.5 * float(self._masses @ np.einsum("ij,ij->i", v, v))


def _potential(context: Any, groups: int) -> float:
    return float(context.getState(energy=True, groups=groups).getPotentialEnergy()._value) if groups else 0.0


def _move(context: Any, x: Array, box: Any) -> None:
    context.setPeriodicBoxVectors(*box)
    context.setPositions(x)
