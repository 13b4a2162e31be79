"""Which forces have a virial pressure: those that follow the periodic box, wherever the particles are in space.

The molecular pressure is the change of the energy if the box and the centres of the molecules are scaled. The energy of
a force that depends on absolute positions, such as a restraint to a point or a wall, changes by an amount that depends
on where the System is. The energy of a force with an own box, such as a formula in which the edges are constants, does
not follow the box of the Context. Neither of these changes is a pressure.

Most forces of OpenMM depend on distances between nearest images or in molecules only. The energies of the others are
evaluated at displaced positions.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context.outside_forces import OURS
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.support.types import Array, Indices

#: Returns the potential energy (kJ/mol) and the sum of the norms of the forces (kJ/mol/nm) for positions and a box.
_Energy = Callable[[Array, Array], tuple[float, float]]

# Displacements of the System relative to the edges of the box.
_DISTANCES = *12 * (1.0,), *4 * (10.0,)
# The number of trials in which molecules are moved to other images, and the relative increase of the box.
_TRIALS, _WIDER = 4, 0.01
# Energies that differ by less than these parts of themselves, and of the work of all forces, are equal: the function of
# a PythonForce may compute in single precision.
_ROUNDOFF, _WORK = 1e-6, 1e-7

_COORDINATE = re.compile(r"(?<![\w.])[xyz]\d*(?!\w)")


def check_virial(context: Any, molecule: Indices, centres: Callable[[Array], Array]) -> None:
    """Raise ValueError if a force of a Context has no virial pressure.

    The arguments are the molecule (n_particles,) of each particle, and a function that returns the centres (molecules,
    3) of the molecules for positions (n_particles, 3).
    """
    state = context.getState(positions=True, parameters=True)
    x, box = arrays.positions(state), np.reshape(arrays.box(state), (3, 3))
    for number, force in enumerate(context.getSystem().getForces()):
        for part in _parts(force):
            if not _may_be_absolute(part):
                continue
            name = f"the {type(part).__name__} {part.getName()!r} (force {number})"
            energy = _energy_of(part, state, context.getSystem(), name)
            if _depends_on_place(energy, x, box, molecule if _has_single_places(part) else np.zeros_like(molecule)):
                raise ValueError(
                    f"{name} depends on absolute positions, so its contribution is no pressure: restrain particles "
                    "relative to a centre of mass (for example, with a CustomCentroidBondForce), or create the "
                    "AverageReporter with pressure=False"
                )
            if _has_own_box(energy, x, box, molecule, centres):
                raise ValueError(
                    f"{name} does not follow the periodic box of the Context, so its contribution to the pressure is "
                    "unknown: compute its energy with the box of the Context, or create the AverageReporter with "
                    "pressure=False"
                )


def _parts(force: Any) -> Iterator[Any]:
    """Return a force, or the forces of which it consists."""
    if isinstance(force, openmm.CustomCVForce):
        inner = [force.getCollectiveVariable(i) for i in range(force.getNumCollectiveVariables())]
    elif isinstance(force, openmm.ATMForce):  # a copy has the type of the force
        inner = [copy.deepcopy(force.getForce(i)) for i in range(force.getNumForces())]
    else:
        yield force
        return
    for part in inner:
        yield from _parts(part)


def _may_be_absolute(force: Any) -> bool:
    """Return whether a force may depend on absolute positions: its formula does, or it has no formula."""
    if type(force) is openmm.Force or type(force).__module__ != openmm.Force.__module__:
        return True  # a plugin's
    if force.getName() in OURS:
        return False
    return isinstance(force, openmm.PythonForce) or any(map(_COORDINATE.search, _formulas(force)))


def _formulas(force: Any) -> Sequence[str]:
    """Return the formulas of a force that may contain coordinates."""
    if isinstance(force, openmm.CustomGBForce):
        values = [force.getComputedValueParameters(i) for i in range(force.getNumComputedValues())]
        terms = [force.getEnergyTermParameters(i) for i in range(force.getNumEnergyTerms())]
        return [*(expression for _, expression, _ in values), *(expression for expression, _ in terms)]
    of_positions = (
        *(openmm.CustomExternalForce, openmm.CustomCompoundBondForce),
        *(openmm.CustomCentroidBondForce, openmm.CustomManyParticleForce),
    )
    return [force.getEnergyFunction()] if isinstance(force, of_positions) else []


def _has_single_places(force: Any) -> bool:
    """Return whether each term of the energy depends on a single place, so that molecules are not bound by it."""
    if isinstance(force, openmm.CustomCompoundBondForce):
        return bool(force.getNumParticlesPerBond() == 1)
    if isinstance(force, openmm.CustomCentroidBondForce):
        return bool(force.getNumGroupsPerBond() == 1)
    return isinstance(force, openmm.CustomExternalForce)


def _energy_of(force: Any, state: openmm.State, system: openmm.System, name: str) -> _Energy:
    """Return the energy of a single force, in a Context of its own."""
    groups = -1
    try:
        own = copy.deepcopy(force)
    except openmm.OpenMMException:  # the function of a PythonForce that pickle does not support
        groups = 1 << force.getForceGroup()
        if sum(other.getForceGroup() == force.getForceGroup() for other in system.getForces()) > 1:
            raise ValueError(
                f"{name} cannot be copied, so it is not known whether it has a pressure: define its function at the "
                "top level of a module, put it into a force group of its own, or create the AverageReporter with "
                "pressure=False"
            ) from None
    else:
        masses = [system.getParticleMass(i) for i in range(system.getNumParticles())]
        system = openmm.System()
        for mass in masses:
            system.addParticle(mass)
        system.setDefaultPeriodicBoxVectors(*state.getPeriodicBoxVectors())
        system.addForce(own)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    arrays.take_parameters(context, state)

    def energy(x: Array, box: Array) -> tuple[float, float]:
        context.setPeriodicBoxVectors(*box)
        context.setPositions(x)
        found = context.getState(energy=True, forces=True, groups=groups)
        return found.getPotentialEnergy()._value, float(np.linalg.norm(arrays.forces(found), axis=1).sum())

    return energy


def _depends_on_place(energy: _Energy, x: Array, box: Array, group: Indices) -> bool:
    """Return whether an energy changes if all particles of each group (n_particles,) are displaced by the same vector.

    A uniform field on ions with opposite charges depends on the place of each ion, though not on that of all ions.
    """
    rng, edges = np.random.default_rng(0), np.linalg.norm(box, axis=1)
    before = energy(x, box)
    shifts = (distance * edges * rng.uniform(-1.0, 1.0, (group.max() + 1, 3)) for distance in _DISTANCES)
    return any(
        _differ(before, energy(x + shift[group], box), np.linalg.norm(edges + abs(shift).max(axis=0)))
        for shift in shifts
    )


def _has_own_box(energy: _Energy, x: Array, box: Array, molecule: Indices, centres: Callable[[Array], Array]) -> bool:
    """Return whether an energy has the periods of the present box, and keeps them in a wider box."""
    rng = np.random.default_rng(0)
    wide, wider = x + _WIDER * centres(x)[molecule], (1.0 + _WIDER) * box
    for _ in range(_TRIALS):
        images = rng.integers(-1, 2, (molecule.max() + 1, 3))[molecule]
        here, there = (
            _differ(energy(y, edges), energy(y + images @ edges, edges), np.linalg.norm(edges))
            for y, edges in ((x, box), (wide, wider))
        )
        if there and not here:
            return True
    return False


def _differ(one: tuple[float, float], other: tuple[float, float], length: Any) -> bool:
    """Return whether two energies differ by more than roundoff for displacements of a given length (nm)."""
    (energy, force), (moved, _) = one, other
    return not abs(moved - energy) <= _ROUNDOFF * abs(energy) + _WORK * force * float(length)
