"""Contexts of the same System: another one like a given one, and another program behind one that stays the same."""

from __future__ import annotations

from typing import Any

import openmm

from openmm_exactrb.context import arrays

# What a Context is asked for; other properties say what came of it.
_PROPERTIES = (
    "DeviceIndex",
    "DeterministicForces",
    "DisablePmeStream",
    "OpenCLPlatformIndex",
    "Precision",
    "TempDirectory",
    "UseBlockingSync",
    "UseCpuPme",
)
# What OpenMM's integrators are told by methods: getX and setX.
_SETTINGS = ("ConstraintTolerance", "KineticEnergyExpression", "RandomNumberSeed", "StepSize")


def properties(context: Any) -> dict[str, str]:
    """Return the properties with which a Context like another one is made."""
    platform = context.getPlatform()
    known = set(platform.getPropertyNames()) & set(_PROPERTIES)
    return {name: platform.getPropertyValue(context, name) for name in sorted(known)}


def bring_to(context: Any, other: Any) -> None:
    """Bring a Context to the positions, velocities, box, parameters, time and step count of another one."""
    state = other.getState(positions=True, velocities=True, parameters=True)
    context.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    for name, value in state.getParameters().items():
        context.setParameter(name, value)
    context.setTime(state.getTime())
    context.setStepCount(state.getStepCount())
    context.setPositions(arrays.positions(state))
    context.setVelocities(arrays.velocities(state))


def rebind(context: Any, integrator: openmm.CustomIntegrator, program: openmm.CustomIntegrator) -> None:
    """Put another program behind an integrator that has a Context, which OpenMM's own methods do not allow.

    What OpenMM has made of both is made anew, as by ``reinitialize``; the Python objects stay, with all who hold them.
    The state goes along. So do the variables where both have the same ones, and else the numbers that both have.

    Parameters
    ----------
    context : openmm.Context
        With positions.
    integrator : openmm.CustomIntegrator
        With which it was made.
    program : openmm.CustomIntegrator
        Without a Context; it is used up.
    """
    for name in _SETTINGS:
        getattr(program, f"set{name}")(getattr(integrator, f"get{name}")())
    same = _variables(integrator) == _variables(program)
    numbers = set(_numbers(integrator)[1:]) & set(_numbers(program))  # the first one is whose program it is
    for name in numbers:
        program.setGlobalVariableByName(name, integrator.getGlobalVariableByName(name))
    platform = context.getPlatform()
    renewed = openmm.Context(context.getSystem(), program, platform, properties(context))
    if same:
        renewed.loadCheckpoint(context.createCheckpoint())
    else:
        bring_to(renewed, context)
    for one, other in ((context, renewed), (integrator, program)):
        one.this, other.this = other.this, one.this


def _numbers(integrator: openmm.CustomIntegrator) -> list[str]:
    return list(map(integrator.getGlobalVariableName, range(integrator.getNumGlobalVariables())))


def _variables(integrator: openmm.CustomIntegrator) -> list[str]:
    vectors = map(integrator.getPerDofVariableName, range(integrator.getNumPerDofVariables()))
    return [*_numbers(integrator), *vectors]
