"""OpenMM's minimiser where bodies are named by hand, of which it knows nothing."""

from __future__ import annotations

import functools
from typing import Any

import openmm


def minimise_by_integrators(kind: type[Any]) -> None:
    """Have integrators of a kind minimise the energy, by ``minimizeEnergy``, where they have bodies named by hand.

    OpenMM's minimiser would deform these, and the first step would take the deformed shape. Its method is replaced,
    since ``Simulation.minimizeEnergy`` calls it before the integrator knows its Context.
    """
    minimize = openmm.LocalEnergyMinimizer.minimize

    @functools.wraps(minimize)
    def minimise(context: Any, tolerance: Any = 10.0, maxIterations: int = 0, reporter: Any = None) -> None:
        integrator: Any = context.getIntegrator()
        if not isinstance(integrator, kind) or not integrator.getNamedBodies():
            minimize(context, tolerance, maxIterations, reporter)
            return
        if reporter is not None:
            raise ValueError("minimisation with bodies named by hand does not support reporter=: omit it")
        integrator.minimizeEnergy(tolerance, maxIterations)

    openmm.LocalEnergyMinimizer.minimize = staticmethod(minimise)
