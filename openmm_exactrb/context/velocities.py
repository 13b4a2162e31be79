"""``Context.setVelocitiesToTemperature`` for Contexts with an integrator of this package.

OpenMM draws the velocities of particles, and its constraint solver removes their components along the constraints. The
momenta of rigid bodies are then canonical, because constraint impulses leave them unchanged. With redundant
constraints, however, the solver may diverge, or leave motions that bend a straight or flat body. The solver supports
neither molecules that the box has split nor bodies passed as `bodies`. In addition, the centre of mass moves until a
CMMotionRemover acts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context.solver import solvable
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.openmm_access.units import gas_constant_times

# Largest velocity along a constraint that a converged solver may leave, relative to the thermal speed of the lightest
# particle.
_LEFT = 1e-3


def draw(original: Callable[..., None], context: Any, *arguments: Any) -> None:
    """Draw velocities as OpenMM does, or by the integrator's method of the same name if OpenMM's solver fails.

    `original` is the method of OpenMM.
    """
    integrator: Any = context.getIntegrator()
    before = context.getState(velocities=True).getVelocities()
    if not integrator.getNamedBodies():
        original(context, *arguments)
        if _fit(context, *arguments):
            _stop(context)
            return
    context.setVelocities(before)
    integrator.setVelocitiesToTemperature(*arguments)


def _fit(context: Any, temperature: Any, *_: Any) -> bool:
    """Return whether OpenMM's solver supports the constraints, and leaves no velocity components along them."""
    system, state = context.getSystem(), context.getState(positions=True, velocities=True)
    x, v, masses = arrays.positions(state), arrays.velocities(state), parameters.masses(system)
    if not np.isfinite(v).all() or not solvable(system, x):
        return False
    i, j = parameters.constraints(system)[0].T
    apart = x[i] - x[j]
    slow = _LEFT * math.sqrt(gas_constant_times(temperature) / np.min(masses, where=masses > 0.0, initial=math.inf))
    along = np.abs(np.einsum("ij,ij->i", v[i] - v[j], apart)) / np.linalg.norm(apart, axis=1)
    return bool((along <= slow).all())


def _stop(context: Any) -> None:
    """Bring the centre of mass to rest if the System has a CMMotionRemover, as the remover would do in a later step."""
    system = context.getSystem()
    if any(isinstance(force, openmm.CMMotionRemover) for force in system.getForces()):
        v, masses = arrays.velocities(context.getState(velocities=True)), parameters.masses(system)
        context.setVelocities(v - np.where(masses[:, None] > 0.0, masses @ v / masses.sum(), 0.0))
