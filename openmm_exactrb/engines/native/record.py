"""The record of the native engine, and the preparation of its integrators."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.engines.engine import Engine, Propagator, Settings
from openmm_exactrb.engines.native.flexible.molecules import served
from openmm_exactrb.engines.native.propagator import NativePropagator
from openmm_exactrb.errors import MissingLibraryError, NotServedError
from openmm_exactrb.library.library import TYPE, Machine, describe, library
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.openmm_access import platforms
from openmm_exactrb.rotors import ROTORS
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.steps.moves import Op, of_substep
from openmm_exactrb.steps.substeps import Drift, HeatExchange, Substep
from openmm_exactrb.support.descriptions import mismatch

_ROTORS = ("exact", "exact_numpy")
# The smallest ratio of the moments of inertia of a body; a thermal body with a smaller one may rotate about its axis by
# thousands of radians in a drift.
_SLENDER = 1e-6


def _unsupported(settings: Settings) -> str | None:
    """Return the reason why settings are not supported, or why the library is missing, or None."""
    thermostat, rotor, scheme = settings.thermostat, settings.rotor, settings.scheme
    if settings.constraints:
        own = f"not {settings.constraints[0]!r} in constraints="
        return f"the native engine supports only constraints of the System, {own}"
    if thermostat is not None:
        if thermostat.kernel_exchange(0.0, (0, 0)) is None:
            return f"the native engine does not support {type(thermostat).__name__}"
        if why := mismatch(thermostat, "kernel_exchange", *thermostat.flows):
            return why
    if rotor not in map(ROTORS.get, _ROTORS):
        own = "" if ROTORS.get(rotor.name) is rotor else "your own rotor "
        return f"the native engine supports only the exact rotor, not {own}{rotor.name}"
    if thermostat is None and any(isinstance(substep, HeatExchange) for substep, _ in scheme.rows):
        return f"scheme {scheme.name} contains a thermostat, but the integrator has none"
    try:
        for row in scheme.rows:
            of_substep(*row)
        library()
    except (ValueError, MissingLibraryError) as error:
        return str(error)
    return None


def _unsupported_in(context: Any, settings: Settings) -> str | None:
    """Return the reason why a Context is not supported, or None."""
    platform = context.getPlatform()
    name = platform.getName()
    if name not in platforms.DEVICES + platforms.PROCESSORS:
        return f"the native engine needs the platform CUDA, HIP, OpenCL, CPU or Reference, not {name}"
    if name in platforms.DEVICES and "," in platform.getPropertyValue(context, "DeviceIndex"):
        return "the native engine needs a Context on one device, not on several"
    if name in platforms.PROCESSORS and (own := _with_text(settings.scheme)):
        return f"the kernels for the platform {name} are compiled without the kernel_moves of {own!r}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the propagator issues these warnings
        found = settings.found(context)
        bodies, fast = found.bodies, found.fast
    if (why := _slender(bodies)) is not None:
        return why
    try:
        molecules, evaluated = served(context, bodies, fast, settings)
    except NotServedError as error:
        return str(error)
    if evaluated is not None and (own := _own_drift(settings.scheme)):
        needed = f"which the drifts {own!r} of {settings.outer.name} need"
        return f"the native engine has no kernel for {evaluated.what}, {needed}"
    return _unsupported_beside_molecules(settings) if molecules else None


def _own_drift(scheme: Scheme) -> Drift | None:
    """Return a drift of a class of its own, which inner steps with forces of OpenMM cannot replace, or None."""
    drifts = (substep for substep, _ in scheme.rows if isinstance(substep, Drift))
    return next((drift for drift in drifts if type(drift) is not Drift), None)


def _slender(bodies: RigidBodies) -> str | None:
    """Return which body is so slender that kernels would divide a drift into too many short rotations, or None."""
    moments = bodies.principal_moments
    smallest = np.where(moments > 0.0, moments, np.inf).min(axis=0, initial=np.inf)
    which = np.flatnonzero(smallest < _SLENDER * moments.max(axis=0, initial=0.0))
    if not len(which):
        return None
    return f"the native engine does not support {bodies.name(int(which[0]))}, which is nearly linear"


def _unsupported_beside_molecules(settings: Settings) -> str | None:
    """Return the reason why the kernels of flexible molecules do not support the scheme, or None."""
    if own := _with_text(settings.scheme):
        return f"the native engine has no kernel of {own!r} for flexible molecules"
    return None


def _with_text(scheme: Scheme) -> Substep | None:
    """Return the first substep with a move that is a text of its own, or None."""
    with_text = (row[0] for row in scheme.rows if any(move.op == Op.OWN for move in of_substep(*row)))
    return next(with_text, None)


def _advice(context: Any, settings: Settings) -> tuple[bool, str]:
    name = context.getPlatform().getName()
    if name in platforms.PROCESSORS:
        return True, f"kernels of the library perform the steps on the platform {name}"
    if why := platforms.no_gpu(context):
        return False, why
    return True, f"{name} computes on a GPU"


def _marks(settings: Settings) -> tuple[float, ...]:
    return (variables.native(settings.own_numbers),)


def _declare(integrator: openmm.CustomIntegrator, settings: Settings) -> None:
    variables.declare_native(integrator, settings.own_numbers)


def _release(integrator: openmm.CustomIntegrator) -> None:
    """Delete the program of an integrator."""
    Machine(library(), integrator).load("")


def _propagator(context: Any, integrator: openmm.CustomIntegrator, settings: Settings, timings: Timings) -> Propagator:
    return NativePropagator(context, integrator, settings, timings)


def _prepare_to_read(xml: str) -> None:
    if f'type="{TYPE}"' in xml:
        library()


#: The record of the native engine.
NATIVE = Engine(
    name="native",
    unsupported=_unsupported,
    unsupported_in=_unsupported_in,
    advice=_advice,
    marks=_marks,
    declare=_declare,
    release=_release,
    propagator=_propagator,
    prepare_to_read=_prepare_to_read,
    information=describe,
)
