"""What the device supports: settings, Contexts, and what a program for them has to be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context.synchronisation import require_positions
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines.custom_program import fast_group, gather, names
from openmm_exactrb.engines.custom_program.program import Layout
from openmm_exactrb.engines.custom_program.rows import Inner, Table
from openmm_exactrb.engines.engine import Settings
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.clusters import ClusterKind
from openmm_exactrb.multiple_time_steps.fast_forces import fast_forces
from openmm_exactrb.openmm_access import arrays, platforms
from openmm_exactrb.rotors import ROTORS, Rotor
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.thermostatted import canonical_momenta
from openmm_exactrb.thermostat import Thermostat

_ROTORS = ("exact", "exact_numpy", "exact_compiled")
# Of OpenMM's constraints on stars: most particles about the middle one, and how much lengths and masses may differ.
_RAYS, _ALIKE = 3, 1e-8
# Particles of a body for SETTLE.
_TRIANGLE = 3
_NO_GROUP = (
    "inner steps on the device need a force group that no other force is in, but all are taken: give forces that act "
    "alike the same one"
)


class UnsupportedError(Exception):
    """The device does not support something; the text says what."""


@dataclass(frozen=True)
class Needs:
    """What a Context needs of a program.

    Attributes
    ----------
    layout : Layout
    fast : tuple of int
        The indices of the fast forces in the System.
    """

    layout: Layout
    fast: tuple[int, ...] = ()

    @property
    def note(self) -> str | None:
        """What the host does by rule, because no GPU has been measured with it; None for rigid bodies alone."""
        if self.fast:
            return "inner steps are made on the device only if it is named"
        if self.layout.clusters:
            return "constraints that leave molecules a motion of their own are the device's only if it is named"
        return None


def unsupported_settings(scheme: Scheme, rotor: Rotor, thermostat: Thermostat | None) -> str | None:
    """Return why the settings of an integrator need the host, or None."""
    if thermostat is not None and thermostat.device_numbers() is None:
        return f"the device supports the Langevin thermostat only, not {type(thermostat).__name__}"
    if rotor not in map(ROTORS.get, _ROTORS):
        own = "" if ROTORS.get(rotor.name) is rotor else "your own rotor "
        return f"the device supports the exact rotor only, not {own}{rotor.name}"
    try:
        Table.of(scheme, thermostat=thermostat is not None)
    except ValueError as error:
        return str(error)
    return None


def needs(context: Any, settings: Settings) -> Needs:
    """Return what a Context needs; UnsupportedError if that is the host."""
    _check_context(context)
    system, scheme, outer = gather.without(context.getSystem()), settings.scheme, settings.outer
    h, groups, named = settings.h, settings.groups, settings.named
    x = arrays.positions(context.getState(positions=True))
    require_positions(context)
    box = arrays.periodic_box(context)
    bodies = find_bodies(system, x, named, box)
    found = fast_forces(system, bodies, settings.fast)
    of = None if found is None or isinstance(found.settings.fast, str) else found.settings.fast
    which = fast_group.indices_of_fast(system, of, groups) if found is not None and found.acts(outer, h) else []
    if which or len(bodies.clusters):
        bodies = find_bodies(system, x, named, box, pairs=True)  # two particles with a constraint may feel fast forces
    if why := gather.unsupported(system, bodies):
        raise UnsupportedError(why)
    sums, clusters = gather.free_group(system, names.GROUP) or 0, bool(len(bodies.clusters))
    if clusters:
        _check_constraints(system, bodies)
    if found is not None and which:
        if why := fast_group.unsupported(system, bodies, which):
            raise UnsupportedError(why)
        group = fast_group.group_of(system, which, of, groups, sums)
        if group is None:
            raise UnsupportedError(_NO_GROUP)
        slow = tuple(fast_group.slow_groups(system, which, group, groups))
        repetitions = found.repetitions(outer, h)
        inner = Inner(found.inner(outer).sequence, lambda part: repetitions(part * h))
        if found.excerpt is not None:  # here inner steps move all particles that are in no rigid body, ions too
            scheme = replace(scheme, sequence=canonical_momenta(scheme.sequence))
        return Needs(Layout(_table(scheme, inner), sums, group, slow, clusters), tuple(which))
    if not clusters:
        return Needs(Layout(Table.of(scheme), sums))
    if outer.order > 2:
        raise UnsupportedError(
            f"on the device, flexible molecules with constraints move by RATTLE, with which {outer.name} would "
            "be of order 2"
        )
    return Needs(Layout(_table(scheme, None), sums, clusters=True))


def _check_context(context: Any) -> None:
    platform, system = context.getPlatform(), context.getSystem()
    name = platform.getName()
    if name not in (*platforms.DEVICES, "Reference"):
        raise UnsupportedError(f"the device supports the platforms CUDA, HIP, OpenCL and Reference only, not {name}")
    if platforms.is_single(context):
        raise UnsupportedError(
            "in single precision the state of the bodies would be rounded: set Precision to mixed or double"
        )
    if name == "Reference" and any(map(system.isVirtualSite, range(system.getNumParticles()))):
        raise UnsupportedError(
            "the Reference platform of OpenMM moves virtual sites at the end of a step only, not within a program"
        )
    for parameter in context.getParameters():
        if parameter in names.OPENMM or names.has(parameter):
            raise UnsupportedError(
                f"the parameter {parameter!r} of a force has the name of a variable of the program: rename it"
            )


def _table(scheme: Scheme, inner: Inner | None) -> Table:
    try:
        return Table.with_constraints(scheme, inner)
    except ValueError as error:
        raise UnsupportedError(f"{error} together with inner steps or flexible molecules with constraints") from error


def _check_constraints(system: openmm.System, bodies: RigidBodies) -> None:
    """Raise ValueError for constraints other than stars and triangles: OpenMM's kernels for these wait for the host."""
    for kind in bodies.clusters.kinds:
        if not _is_star(kind):
            raise UnsupportedError(
                f"{kind.name(0)} has constraints that OpenMM's SHAKE does not support: on the device these may hold an "
                "atom to at most three others, all of one mass and at one distance, as constraints=HBonds makes them"
            )
    held = np.zeros(bodies.n_particles, dtype=bool)
    for i in range(system.getNumConstraints()):
        held[system.getConstraintParameters(i)[0]] = True
    for rigid in bodies.kinds:
        if rigid.turns and rigid.particles.shape[1] != _TRIANGLE and held[rigid.particles].any():
            raise UnsupportedError(
                f"{bodies.name(rigid.bodies.start)} is held rigid by constraints that OpenMM's SETTLE does not "
                "support, together with flexible molecules with constraints: name it in bodies= and remove its "
                "constraints"
            )


def _is_star(kind: ClusterKind) -> bool:
    """Return whether OpenMM has SHAKE for a cluster, whose centre comes first."""
    rays, masses, lengths = len(kind.pairs), kind.masses[1:], kind.lengths
    star = rays == len(masses) <= _RAYS and not len(kind.implied) and not kind.pairs[:, 0].any()
    return bool(star) and _alike(masses) and _alike(lengths)


def _alike(values: NDArray[np.float64]) -> bool:
    return bool(np.ptp(values) <= _ALIKE * values.max())
