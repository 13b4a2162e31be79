"""Sums over bodies as forces of the System, and kernels that apply no constraints.

Each force term applies minus the sum of a body's particle positions to every particle, which turns a force evaluation
into a reduction.

The program writes the summands to the positions, scaled so that all particles of a body are within `REACH` of the
origin. Bodies never are, and outside of it energy and forces are exactly 0: to all others the System is unchanged.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.engines.custom_program import fast_group, names
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.multiple_time_steps.bonded import acting, groups_of

#: Positions are summed where the sum of their squares, in nm², is smaller.
REACH = 1e-6
#: The force is minus the sum of positions times this, in kJ/mol/nm².
STRENGTH = 2.0**44
#: Forces (kJ/mol/nm) that are sure to be summed: devices have them as whole numbers, and lose what is beyond 2^31.
MOST = 2.0**30
_NAME = "openmm-exactrb sums"


def install(system: openmm.System, bodies: RigidBodies, group: int) -> None:
    """Give a System the forces that sum over bodies, unless it has them."""
    turning = [kind.particles for kind in bodies.kinds if kind.turns]
    sizes = sorted({particles.shape[1] for particles in turning})
    forces = [_force(np.concatenate([some for some in turning if some.shape[1] == size]), group) for size in sizes]
    if _as_text(forces) != _as_text(_present(system)):
        remove(system)
        for force in forces:
            system.addForce(force)


def remove(system: openmm.System) -> None:
    """Leave a System without these forces, and forces in their own groups."""
    fast_group.restore(system)
    indices = [index for index, force in enumerate(system.getForces()) if force.getName().startswith(_NAME)]
    for index in reversed(indices):
        system.removeForce(index)


def without(system: openmm.System) -> openmm.System:
    """Return a System as it was before a program was made for it: itself, or a copy."""
    if _present(system) or fast_group.any_moved(system):
        system = copy.deepcopy(system)
        remove(system)
    return system


def make_kernels(context: Any, clusters: bool) -> None:
    """Make the kernels of a Context's program, which has none yet.

    The program makes virtual sites by ``addConstrainPositions``. OpenMM asks, when it makes the kernels, whether the
    System has constraints; if it has no `clusters` it has none then, and they are not applied to what is rigid anyway.
    """
    system = context.getSystem()
    kept = [] if clusters else [system.getConstraintParameters(i) for i in range(system.getNumConstraints())]
    for i in reversed(range(len(kept))):
        system.removeConstraint(i)
    try:
        context.getState(energy=True)
    finally:
        for constraint in kept:
            system.addConstraint(*constraint)


def free_group(system: openmm.System, wanted: int) -> int | None:
    """Return a force group that no other force is in: the wanted one, else the highest, or None."""
    own = [force for force in acting(system) if not force.getName().startswith(_NAME)]
    taken = {group for force in own for group in groups_of(force)}
    return next((group for group in (wanted, *reversed(range(32))) if group not in taken), None)


def unsupported(system: openmm.System, bodies: RigidBodies) -> str | None:
    """Return why a System cannot have the forces, or None: no group is free, or a body is as small as the summands."""
    if free_group(system, names.GROUP) is None:
        return (
            "the engine on the device needs a force group for itself, and the System has forces in all 32: give two "
            "of them the same one"
        )
    for kind in bodies.kinds:
        about_middle = kind.sites - kind.sites.mean(axis=1, keepdims=True)
        if kind.turns and (about_middle**2).sum(axis=(1, 2)).min() < 4.0 * REACH:
            return (
                f"{bodies.name(kind.bodies.start)} or one of its kind is smaller than {2.0 * REACH**0.5:g} nm: the "
                "engine on the device cannot distinguish its positions from numbers"
            )
        if not kind.turns and kind.particles.shape[1] > 1:
            return f"the particles of {bodies.name(kind.bodies.start)} coincide: the engine on the device has no points"
    return None


def _present(system: openmm.System) -> list[openmm.CustomCompoundBondForce]:
    return [force for force in system.getForces() if force.getName().startswith(_NAME)]


def _as_text(forces: list[Any]) -> list[str]:
    return list(map(openmm.XmlSerializer.serialize, forces))


def _force(rows: NDArray[np.intp], group: int) -> openmm.CustomCompoundBondForce:
    """Return the force that sums over bodies with these particles (n, k)."""
    size = rows.shape[1]
    sums = ";".join(f"s{axis}={'+'.join(f'{axis}{i + 1}' for i in range(size))}" for axis in "xyz")
    squares = "+".join(f"{axis}{i + 1}*{axis}{i + 1}" for i in range(size) for axis in "xyz")
    energy = f"{0.5 * STRENGTH!r}*step({REACH!r}-squares)*(sx*sx+sy*sy+sz*sz);{sums};squares={squares}"
    force = openmm.CustomCompoundBondForce(size, energy)
    for row in rows:
        force.addBond(list(map(int, row)), [])
    force.setForceGroup(group)
    force.setName(f"{_NAME} {size}")
    return force
