"""The record of the host engine."""

from __future__ import annotations

from typing import Any

import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.engines.engine import Engine, Settings
from openmm_exactrb.engines.host.propagator import HostPropagator
from openmm_exactrb.library.library import of_library


def _marks(settings: Settings) -> tuple[float, ...]:
    return variables.marks(settings.own_numbers)


def _declare(integrator: openmm.CustomIntegrator, settings: Settings) -> None:
    """Give an integrator its variables; one of the library stores the state itself."""
    if of_library(integrator):
        variables.declare_native(integrator, settings.own_numbers)
    else:
        variables.declare(integrator, settings.own_numbers, settings.memory)


def _propagator(
    context: Any, integrator: openmm.CustomIntegrator, settings: Settings, timings: Timings
) -> HostPropagator:
    if integrator.getGlobalVariable(0) not in (variables.NOTHING, *_marks(settings)):  # the state of another engine
        variables.mark(integrator, variables.NOTHING)
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
