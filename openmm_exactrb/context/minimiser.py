"""Minimisation of Systems on which OpenMM's minimiser fails, because of `bodies` or of unsupported constraints."""

from __future__ import annotations

import functools
from typing import Any

import openmm

from openmm_exactrb.context.solver import mended, satisfied, solvable
from openmm_exactrb.errors import MinimisationError
from openmm_exactrb.openmm_access import arrays

#: The original method of OpenMM's minimiser, which `minimise_by_integrators` replaces.
OPENMM = openmm.LocalEnergyMinimizer.minimize
#: The message after a minimisation by OpenMM that violates the constraints.
VIOLATED = (
    "OpenMM's minimiser could not satisfy the constraints, so the positions are unchanged: relax them by short steps "
    "at high friction with checkDivergence=False"
)


def minimise_by_integrators(kind: type[Any]) -> None:
    """Let integrators of a class minimise the energy with ``minimizeEnergy`` where OpenMM's minimiser fails.

    OpenMM's minimiser would deform bodies passed as `bodies`, and the first step would use the deformed shape. With
    redundant constraints, the minimiser may return NaN or crash. It also pulls together the parts of molecules that the
    box has split. The method of OpenMM's minimiser is replaced because ``Simulation.minimizeEnergy`` calls it before
    the integrator has found its Context.
    """

    @functools.wraps(OPENMM)
    def minimise(context: Any, tolerance: Any = 10.0, maxIterations: int = 0, reporter: Any = None) -> None:
        integrator: Any = context.getIntegrator()
        if not isinstance(integrator, kind):
            OPENMM(context, tolerance, maxIterations, reporter)
            return
        if not integrator.getNamedBodies():
            mended(context)
        system, start = context.getSystem(), arrays.positions(context.getState(positions=True))
        if not integrator.getNamedBodies() and solvable(system, start):
            OPENMM(context, tolerance, maxIterations, reporter)
            if not satisfied(system, arrays.positions(context.getState(positions=True))):
                context.setPositions(start)
                raise MinimisationError(VIOLATED)
            return
        if reporter is not None:
            raise ValueError(
                "reporter= is not supported for bodies given in bodies=, for redundant constraints, or for molecules "
                "that the periodic box has split: omit reporter="
            )
        integrator.minimizeEnergy(tolerance, maxIterations)

    openmm.LocalEnergyMinimizer.minimize = staticmethod(minimise)
