"""What the System and its Context get: forces that sum over bodies, and kernels that leave constraints alone.

A force pushes each particle of a body with minus the sum of their positions.

The program writes what is to be summed where positions are, so small that all particles of a body are within `REACH` of
the origin. Bodies never are, and there energy and forces are exactly 0: what OpenMM shows of a System is what it was.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context.bonded import acting, groups_of
from openmm_exactrb.device import names
from openmm_exactrb.motion.bodies import RigidBodies

#: Positions are summed where the sum of their squares, in nm², is smaller.
REACH = 1e-6
#: The force is minus the sum of positions times this, in kJ/mol/nm².
STRENGTH = 2.0**44
_NAME = "openmm-exactrb sums"


def install(system: openmm.System, bodies: RigidBodies) -> None:
    """Give a System the forces that sum over bodies, unless it has them."""
    needed = _bonds(bodies)
    present = {index: force for index, force in enumerate(system.getForces()) if force.getName().startswith(_NAME)}
    found = {force.getNumParticlesPerBond(): _bonds_of(force) for force in present.values()}
    if found.keys() == needed.keys() and all(np.array_equal(found[size], needed[size]) for size in needed):
        return
    for index in sorted(present, reverse=True):
        system.removeForce(index)
    for size, rows in needed.items():
        system.addForce(_force(size, rows))


def make_kernels(context: Any) -> None:
    """Reinitialise a Context with its state, and make the kernels of its program.

    The program makes virtual sites by ``addConstrainPositions``. OpenMM asks, when it makes the kernels, whether the
    System has constraints; as it has none then, they are not applied to what is rigid anyway.
    """
    system = context.getSystem()
    context.reinitialize(preserveState=True)
    kept = [system.getConstraintParameters(i) for i in range(system.getNumConstraints())]
    for i in reversed(range(len(kept))):
        system.removeConstraint(i)
    try:
        context.getState(energy=True)
    finally:
        for constraint in kept:
            system.addConstraint(*constraint)


def against(system: openmm.System, bodies: RigidBodies) -> str | None:
    """Say why the forces cannot be in a System: their group is taken, or a body is as small as what they sum.

    The group stands in the program, which OpenMM takes only before the System is known.
    """
    own = [force for force in acting(system) if not force.getName().startswith(_NAME)]
    taken = {group: force.getName() for force in own for group in groups_of(force)}
    if names.GROUP in taken:
        free = [group for group in range(names.GROUP, -1, -1) if group not in taken]
        where = f"another one with setForceGroup, {free[0]} is free" if free else "one of another force, none is free"
        return (
            f"the engine on the device needs force group {names.GROUP} for itself, and {taken[names.GROUP]} is in it "
            f"(give that force {where})"
        )
    for kind in bodies.kinds:
        about_middle = kind.sites - kind.sites.mean(axis=1, keepdims=True)
        if kind.turns and (about_middle**2).sum(axis=(1, 2)).min() < 4.0 * REACH:
            return (
                f"{bodies.name(kind.bodies.start)} or one of its kind is smaller than {2.0 * REACH**0.5:g} nm: the "
                "engine on the device cannot tell its places from numbers"
            )
    return None


def _bonds(bodies: RigidBodies) -> dict[int, NDArray[np.intp]]:
    """Return the particles of all bodies of more than one (n, k) by their number k."""
    turning = [kind.particles for kind in bodies.kinds if kind.turns]
    sizes = sorted({particles.shape[1] for particles in turning})
    return {size: np.concatenate([some for some in turning if some.shape[1] == size]) for size in sizes}


def _bonds_of(force: openmm.CustomCompoundBondForce) -> NDArray[np.intp]:
    rows = [force.getBondParameters(i)[0] for i in range(force.getNumBonds())]
    return np.array(rows, dtype=np.intp).reshape(len(rows), -1)


def _force(size: int, rows: NDArray[np.intp]) -> openmm.CustomCompoundBondForce:
    sums = ";".join(f"s{axis}={'+'.join(f'{axis}{i + 1}' for i in range(size))}" for axis in "xyz")
    squares = "+".join(f"{axis}{i + 1}*{axis}{i + 1}" for i in range(size) for axis in "xyz")
    energy = f"{0.5 * STRENGTH!r}*step({REACH!r}-squares)*(sx*sx+sy*sy+sz*sz);{sums};squares={squares}"
    force = openmm.CustomCompoundBondForce(size, energy)
    for row in rows:
        force.addBond(list(map(int, row)), [])
    force.setForceGroup(names.GROUP)
    force.setName(f"{_NAME} {size}")
    return force
