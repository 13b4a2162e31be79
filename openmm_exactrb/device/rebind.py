"""Another program behind an integrator that has a Context, which OpenMM's own methods do not allow."""

from __future__ import annotations

from typing import Any

import openmm

from openmm_exactrb.context import arrays

# Properties of a platform that only report.
_REPORTED = ("DeviceName", "OpenCLPlatformName")
# Settings of OpenMM's integrators: getX and setX.
_SETTINGS = ("ConstraintTolerance", "KineticEnergyExpression", "RandomNumberSeed", "StepSize")


def rebind(context: Any, integrator: openmm.CustomIntegrator, program: openmm.CustomIntegrator) -> None:
    """Replace the program of an integrator in its Context.

    OpenMM's objects are replaced, as by ``reinitialize``; the Python objects stay, and so do all references to them.
    The state of the Context is kept, and the value of every global variable that both programs have.

    Parameters
    ----------
    context : openmm.Context
    integrator : openmm.CustomIntegrator
        The integrator of the Context.
    program : openmm.CustomIntegrator
        An integrator without a Context, which is used up.
    """
    for name in _SETTINGS:
        getattr(program, f"set{name}")(getattr(integrator, f"get{name}")())
    known = _global_variables(integrator)[1:]  # the first one says which engine wrote the variables
    for name in set(known) & set(_global_variables(program)):
        program.setGlobalVariableByName(name, integrator.getGlobalVariableByName(name))
    renewed = openmm.Context(context.getSystem(), program, context.getPlatform(), _properties(context))
    _copy_state(context, renewed)
    for one, other in ((context, renewed), (integrator, program)):
        one.this, other.this = other.this, one.this


def _global_variables(integrator: openmm.CustomIntegrator) -> list[str]:
    return list(map(integrator.getGlobalVariableName, range(integrator.getNumGlobalVariables())))


def _properties(context: Any) -> dict[str, str]:
    platform = context.getPlatform()
    return {n: platform.getPropertyValue(context, n) for n in platform.getPropertyNames() if n not in _REPORTED}


def _copy_state(context: Any, other: Any) -> None:
    state = context.getState(positions=True, velocities=True, parameters=True)
    other.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    for name, value in state.getParameters().items():
        other.setParameter(name, value)
    other.setTime(state.getTime())
    other.setStepCount(state.getStepCount())
    other.setPositions(arrays.positions(state))
    other.setVelocities(arrays.velocities(state))
