"""OpenMM's minimiser where it cannot minimise: bodies named by hand, and constraints that do not suit its solver."""

from __future__ import annotations

import functools
from typing import Any

import openmm

from openmm_exactrb.context.solver import solvable
from openmm_exactrb.openmm_access import arrays

#: The method of OpenMM.
OPENMM = openmm.LocalEnergyMinimizer.minimize


def minimise_by_integrators(kind: type[Any]) -> None:
    """Have integrators of a kind minimise the energy, by ``minimizeEnergy``, where OpenMM's minimiser cannot.

    It would deform bodies named by hand, and the first step would take the deformed shape. Where constraints follow
    from others it ends in NaN or kills the process, and molecules that the box has split it drags together. Its method
    is replaced, since ``Simulation.minimizeEnergy`` calls it before the integrator knows its Context.
    """

    @functools.wraps(OPENMM)
    def minimise(context: Any, tolerance: Any = 10.0, maxIterations: int = 0, reporter: Any = None) -> None:
        integrator: Any = context.getIntegrator()
        if not isinstance(integrator, kind) or (not integrator.getNamedBodies() and _suits(context)):
            OPENMM(context, tolerance, maxIterations, reporter)
            return
        if reporter is not None:
            raise ValueError(
                "minimisation with bodies named by hand, or constraints that follow from others, does not support "
                "reporter=: omit it"
            )
        integrator.minimizeEnergy(tolerance, maxIterations)

    openmm.LocalEnergyMinimizer.minimize = staticmethod(minimise)


def _suits(context: Any) -> bool:
    return solvable(context.getSystem(), arrays.positions(context.getState(positions=True)))
