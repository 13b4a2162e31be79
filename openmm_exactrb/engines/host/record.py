"""The record of the host engine."""

from __future__ import annotations

from typing import Any

import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.engines.engine import Engine, Settings
from openmm_exactrb.engines.host.propagator import HostPropagator
from openmm_exactrb.openmm_access.rebind import rebind


def _marks(settings: Settings) -> tuple[float, ...]:
    return variables.marks(settings.own_numbers)


def _declare(integrator: openmm.CustomIntegrator, settings: Settings) -> None:
    scheme = settings.scheme
    variables.declare(integrator, settings.own_numbers, sum(scheme.memory) if scheme.processor else None)


def _propagator(
    context: Any, integrator: openmm.CustomIntegrator, settings: Settings, timings: Timings
) -> HostPropagator:
    """Return a propagator for an integrator, which is first given the variables of the host if necessary."""
    own = (variables.NOTHING, *_marks(settings))
    if not variables.declared(integrator) or integrator.getGlobalVariable(0) not in own:
        program = openmm.CustomIntegrator(0.0)
        _declare(program, settings)
        program.setIntegrationForceGroups(settings.groups)
        rebind(context, integrator, program)
    return HostPropagator(context, integrator, settings, timings)


#: The record of the host engine.
HOST = Engine(
    name="host",
    unsupported=lambda settings: None,
    unsupported_in=lambda context, settings: None,
    advice=lambda context, settings: (True, "the host supports every System on every platform"),
    marks=_marks,
    declare=_declare,
    propagator=_propagator,
    information=lambda: "kernels of this package, on every platform",
)
