"""Energy from nowhere on the device, noticed at the end of a call as the host notices it at the end of a step."""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context import arrays
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.guard import canonical_most, gained, grown

Array = NDArray[np.float64]


class Watch:
    """Looks at the energy of a Context whose steps the device makes.

    Velocities, which are read anyway, tell whether the kinetic energy has grown. Only then are energies evaluated.

    Parameters
    ----------
    system : openmm.System
    bodies : RigidBodies
    warmest : float
        kT (kJ/mol) up to which a thermostat or barostat of the System may heat the bodies.
    """

    def __init__(self, system: openmm.System, bodies: RigidBodies, warmest: float) -> None:
        self._masses = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])
        self._bodies, self._warmest = bodies, warmest

    def suspects(self, then: Array, now: Array, kT: float) -> bool:
        """Tell whether the energy is to be looked at.

        Parameters
        ----------
        then, now : (n_particles, 3) array
            Velocities (nm/ps) before and after a call.
        kT : float
            Of a bath, in kJ/mol; 0 without one.
        """
        freedom = self._bodies.translational_freedom + self._bodies.rotational_freedom
        good = max(self._kinetic(then), 0.5 * canonical_most(max(kT, self._warmest), freedom))
        return grown([self._kinetic(now)], [good])

    def gained(self, context: Any, groups: int, x: Array, v: Array, box: Any) -> str | None:
        """Say that energy came from nowhere in a call that began at x (nm), v (nm/ps) and box, or return None.

        The Context, which the call has left, keeps its positions and its box up to their rounding. The bits of
        `groups` tell which force groups act.
        """
        now = context.getState(positions=True, velocities=True)
        kinetic_then, kinetic = self._kinetic(v), self._kinetic(arrays.velocities(now))
        energy = kinetic + _potential(context, groups)
        _move(context, x, box)
        energy_then = kinetic_then + _potential(context, groups)
        _move(context, arrays.positions(now), now.getPeriodicBoxVectors())
        return gained(len(self._bodies), (kinetic_then, energy_then), (kinetic, energy))

    def _kinetic(self, v: Array) -> float:
        return 0.5 * float(self._masses @ np.einsum("ij,ij->i", v, v))


def _potential(context: Any, groups: int) -> float:
    return float(context.getState(energy=True, groups=groups).getPotentialEnergy()._value) if groups else 0.0


def _move(context: Any, x: Array, box: Any) -> None:
    context.setPeriodicBoxVectors(*box)
    context.setPositions(x)
