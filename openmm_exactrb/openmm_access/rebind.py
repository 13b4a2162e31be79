"""The replacement of the program of an integrator that has a Context, which OpenMM's methods do not allow."""

from __future__ import annotations

from typing import Any

import openmm

# Properties of a platform that cannot be set.
_REPORTED = ("DeviceName", "OpenCLPlatformName")
# Settings of OpenMM's integrators, which have methods getX and setX.
_SETTINGS = ("ConstraintTolerance", "KineticEnergyExpression", "RandomNumberSeed", "StepSize")


def rebind(context: Any, integrator: openmm.CustomIntegrator, program: openmm.CustomIntegrator) -> None:
    """Replace the program of an integrator in its Context.

    OpenMM's C++ objects are replaced, as by ``reinitialize``. The Python objects and all references to them remain. The
    state of the Context and the values of global variables that both programs have are preserved. The integrator that
    provided the new program has no Context, and cannot be used afterwards.
    """
    for name in _SETTINGS:
        getattr(program, f"set{name}")(getattr(integrator, f"get{name}")())
    known = _global_variables(integrator)[1:]  # the first one identifies the engine that wrote the variables
    for name in set(known) & set(_global_variables(program)):
        program.setGlobalVariableByName(name, integrator.getGlobalVariableByName(name))
    platform = context.getPlatform()
    properties = {n: platform.getPropertyValue(context, n) for n in platform.getPropertyNames() if n not in _REPORTED}
    renewed = openmm.Context(context.getSystem(), program, platform, properties)
    renewed.setState(context.getState(positions=True, velocities=True, parameters=True))
    for one, other in ((context, renewed), (integrator, program)):
        one.this, other.this = other.this, one.this


def _global_variables(integrator: openmm.CustomIntegrator) -> list[str]:
    return list(map(integrator.getGlobalVariableName, range(integrator.getNumGlobalVariables())))
