"""Methods that act differently if the integrator of a Context belongs to this package.

An integrator of the package's library knows its Context from the beginning, and draws velocities in that Context alone.
Without a library, the Context is unknown until the first step. Three methods are then replaced for the whole process
when the first integrator is created, and call the original method if a Context has another integrator.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import openmm

from openmm_exactrb.context.minimiser import minimise
from openmm_exactrb.context.states import load
from openmm_exactrb.context.velocities import draw
from openmm_exactrb.context.watch import replace


def give_to(context: openmm.Context, kind: type[Any]) -> None:
    """Let one Context draw velocities by integrators of a class."""
    replace(context, "setVelocitiesToTemperature", _for_integrators(kind, draw))


@functools.cache
def replace_in_openmm(kind: type[Any]) -> None:
    """Replace three methods of OpenMM for integrators of a class."""
    for owner, name, function in (
        (openmm.Context, "setVelocitiesToTemperature", _for_integrators(kind, draw)),
        (openmm.Context, "setState", functools.partial(load, kind)),
        (openmm.LocalEnergyMinimizer, "minimize", _for_integrators(kind, minimise)),
    ):
        replacing = _replacing(getattr(owner, name), function)
        setattr(owner, name, staticmethod(replacing) if isinstance(vars(owner)[name], staticmethod) else replacing)


def _for_integrators(kind: type[Any], function: Callable[..., None]) -> Callable[..., None]:
    """Return a function that calls the original method unless the integrator of a Context is of a class."""

    def acting(original: Callable[..., None], context: Any, *arguments: Any, **options: Any) -> None:
        if isinstance(context.getIntegrator(), kind):
            function(original, context, *arguments, **options)
        else:
            original(context, *arguments, **options)

    return acting


def _replacing(original: Callable[..., None], function: Callable[..., None]) -> Callable[..., None]:
    @functools.wraps(original)
    def replacing(*arguments: Any, **options: Any) -> None:
        function(original, *arguments, **options)

    return replacing
