"""The engine of CustomIntegrator's programs, as the rest of the package sees it, and what it prepares."""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import openmm

from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.engines.custom_program import emit, fast_group, gather, names
from openmm_exactrb.engines.custom_program.engine import DevicePropagator
from openmm_exactrb.engines.custom_program.program import Layout
from openmm_exactrb.engines.custom_program.rows import Table
from openmm_exactrb.engines.custom_program.support import Needs, UnsupportedError, needs, unsupported_settings
from openmm_exactrb.engines.engine import Engine, Settings
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.openmm_access import platforms
from openmm_exactrb.openmm_access.rebind import rebind

# Of OpenMM's constraints, where they close drifts, as a part of a length; OpenMM's own default is 1e-5.
_TOLERANCE, _USUAL = 1e-8, 1e-5
# The programs that integrators have, and what gives the forces of Contexts their own groups back.
_LAYOUTS: WeakKeyDictionary[Any, Layout] = WeakKeyDictionary()
_ENDS: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()


def _unsupported(settings: Settings) -> str | None:
    return unsupported_settings(settings.scheme, settings.rotor, settings.thermostat)


def _unsupported_in(context: Any, settings: Settings) -> str | None:
    try:
        needs(context, settings)
    except UnsupportedError as error:
        return str(error)
    return None


def _advice(context: Any, settings: Settings) -> tuple[bool, str]:
    why = platforms.no_gpu(context) or needs(context, settings).note
    return not why, why or f"{context.getPlatform().getName()} computes on a GPU"


def _declare(integrator: openmm.CustomIntegrator, settings: Settings) -> None:
    _write(integrator, Layout(Table.of(settings.scheme), names.GROUP), settings.groups)
    _tighten(integrator)
    _LAYOUTS[integrator] = Layout(Table.of(settings.scheme), names.GROUP)


def _write(integrator: openmm.CustomIntegrator, layout: Layout, groups: int) -> None:
    """Write a program into an integrator without a Context."""
    emit.declare(integrator, layout)
    _set_groups(integrator, layout, groups)


def _set_groups(integrator: openmm.CustomIntegrator, layout: Layout, groups: int) -> None:
    """Set which force groups act, by their bits.

    For OpenMM's minimiser and barostats that of the fast forces does too, but not that of the sums over bodies.
    """
    fast = 0 if layout.fast is None else 1 << layout.fast
    others = (groups | fast) & 0xFFFFFFFF & ~(1 << layout.sums)
    openmm.CustomIntegrator.setIntegrationForceGroups(integrator, others)


def _propagator(
    context: Any, integrator: openmm.CustomIntegrator, settings: Settings, timings: Timings
) -> DevicePropagator:
    wanted = needs(context, settings)
    pairs = wanted.layout.table.constrained
    bodies = Synchronisation(context, integrator, settings.named, pairs).bodies
    _install(context, integrator, settings, wanted, bodies)
    return DevicePropagator(context, integrator, settings, timings, wanted.layout)


def _install(
    context: Any, integrator: openmm.CustomIntegrator, settings: Settings, wanted: Needs, bodies: RigidBodies
) -> None:
    """Add the sums over bodies to the System, and give the integrator the program that uses them."""
    system, layout = context.getSystem(), wanted.layout
    fast_group.restore(system)
    gather.install(system, bodies, layout.sums)
    if layout.fast is not None:
        fast_group.move(system, wanted.fast, layout.fast)
        if context not in _ENDS or not _ENDS[context].alive:
            _ENDS[context] = fast_group.restore_after(context)
    if _LAYOUTS.get(integrator) == layout and integrator.getGlobalVariableName(0) == names.LOADED:
        _set_groups(integrator, layout, settings.groups)
        context.reinitialize(preserveState=True)
    else:
        _tighten(integrator)
        program = openmm.CustomIntegrator(0.0)
        _write(program, layout, settings.groups)
        rebind(context, integrator, program)
    _LAYOUTS[integrator] = layout
    gather.make_kernels(context, layout.clusters)


def _release(context: Any) -> None:
    """Remove the sums over bodies, and give forces that were moved to a group of theirs their own groups."""
    system = context.getSystem()
    moved = fast_group.any_moved(system)
    gather.remove(system)
    fast_group.restore(system)
    if moved:
        context.reinitialize(preserveState=True)


def _tighten(integrator: openmm.CustomIntegrator) -> None:
    """Set the tolerance of OpenMM's constraints that programs need, unless a user has set one."""
    if integrator.getConstraintTolerance() == _USUAL:
        integrator.setConstraintTolerance(_TOLERANCE)


DEVICE = Engine(
    name="device",
    unsupported=_unsupported,
    unsupported_in=_unsupported_in,
    advice=_advice,
    marks=lambda settings: (names.HELD,),
    declare=_declare,
    propagator=_propagator,
    release=_release,
)
