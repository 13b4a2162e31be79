"""Energy from nowhere on the device, noticed at the end of a call as the host notices it at the end of a step."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.context import arrays
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.guard import canonical_most, differ, gained, grown, instants

Array = NDArray[np.float64]


class Before(NamedTuple):
    """What a Context held before a call: positions (nm), velocities (nm/ps), box, time and number of the last step."""

    x: Array
    v: Array
    box: Any
    time: Any
    step: int


class Watch:
    """Looks at the energy of a Context whose steps the device makes.

    Velocities, which are read anyway, tell whether the kinetic energy has grown. Only then are energies evaluated.

    Parameters
    ----------
    system : openmm.System
    bodies : RigidBodies
    """

    def __init__(self, system: openmm.System, bodies: RigidBodies) -> None:
        self._masses = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])
        self._bodies = bodies

    def suspects(self, then: Array, now: Array, kT: float) -> bool:
        """Tell whether the energy is to be looked at.

        Parameters
        ----------
        then, now : (n_particles, 3) array
            Velocities (nm/ps) before and after a call.
        kT : float
            Of the hottest bath, in kJ/mol; 0 without one.
        """
        freedom = self._bodies.translational_freedom + self._bodies.rotational_freedom
        good = max(self._kinetic(then), 0.5 * canonical_most(kT, freedom))
        return grown([self._kinetic(now)], [good])

    def gained(self, context: Any, groups: int, then: Before) -> str | None:
        """Say that energy came from nowhere in a call, or return None: so where forces look at the time.

        The Context, which the call has left, keeps its positions and its box up to their rounding. The bits of
        `groups` tell which force groups act.
        """
        now, n = context.getState(positions=True, velocities=True), len(self._bodies)
        kinetic_then, kinetic = self._kinetic(then.v), self._kinetic(arrays.velocities(now))
        potential, others = _potential(context, groups), _at_times(context, groups, then.time)
        _move(context, then.x, then.box)
        potential_then, others_then = _potential(context, groups), _at_times(context, groups, then.time)
        _move(context, arrays.positions(now), now.getPeriodicBoxVectors())
        if differ([potential, *others], n) or differ([potential_then, *others_then], n):
            return None
        return gained(n, (kinetic_then, kinetic_then + potential_then), (kinetic, kinetic + potential))

    def _kinetic(self, v: Array) -> float:
        return 0.5 * float(self._masses @ np.einsum("ij,ij->i", v, v))


def _at_times(context: Any, groups: int, since: Any) -> list[float]:
    """Return the potential energy (kJ/mol) at times between one and the present one."""
    now, energies = context.getTime(), []
    for time in instants(*(t.value_in_unit(unit.picosecond) for t in (since, now))):
        context.setTime(time)
        energies.append(_potential(context, groups))
    context.setTime(now)
    return energies


def _potential(context: Any, groups: int) -> float:
    return float(context.getState(energy=True, groups=groups).getPotentialEnergy()._value) if groups else 0.0


def _move(context: Any, x: Array, box: Any) -> None:
    context.setPeriodicBoxVectors(*box)
    context.setPositions(x)
