"""Heavier hydrogens: mass repartitioned within molecules, so that longer steps are stable."""

from __future__ import annotations

from collections import Counter

import openmm
from openmm import app, unit

from openmm_exactrb.openmm_access.units import stripped
from openmm_exactrb.support import checks
from openmm_exactrb.support.messages import shown

_WATER = Counter({8: 1, 1: 2})  # by atomic number, so that deuterium counts as hydrogen


def heavy_hydrogens(
    system: openmm.System, topology: app.Topology, mass: float | unit.Quantity = 3.0, water: bool = True
) -> None:
    """Change the mass of hydrogens; the difference is taken from the heavier atom to which each is bonded.

    Call this function before the Context is created, or call ``context.reinitialize(preserveState=True)`` afterwards.
    The mass of each molecule does not change. Librations of water and vibrations of angles with hydrogen become slower,
    which allows longer steps.

    The new masses change the dynamics of rotations, through the moments of inertia, and of vibrations of hydrogens, and
    therefore diffusion and viscosity. For rigid molecules, and for atoms without constraints, averages of functions of
    positions do not depend on masses. If several bonds of one atom are constrained, as with HBonds, the distribution of
    the angles between these bonds has a weight sqrt(det(J M^-1 J^T)) that depends on the masses. For two bonds of a
    carbon with hydrogens of 3 amu, the weight corresponds to 0.005 kT at 10 degrees from the tetrahedral angle.

    Parameters
    ----------
    system : openmm.System
        The System, which is changed in place.
    topology : openmm.app.Topology
        The Topology, with the elements of the atoms and their bonds.
    mass : float or Quantity
        New mass of each hydrogen, in amu if it has no unit.
    water : bool
        Whether to include the hydrogens of water: residues of one oxygen and two hydrogens, with or without virtual
        sites.

    Raises
    ------
    ValueError
        If the Topology has no hydrogens, a heavier atom would become lighter than its hydrogens, a hydrogen is not
        bonded to a heavier atom, or System and Topology do not match. In these cases no mass is changed.
    """
    if not isinstance(system, openmm.System) or not isinstance(topology, app.Topology):
        raise ValueError(
            f"heavy_hydrogens() takes an openmm.System and its Topology, not {type(system).__name__} and "
            f"{type(topology).__name__}: call it before you create a Simulation"
        )
    wanted = checks.positive(stripped(mass, unit.dalton), "mass", "amu")
    if not isinstance(water, bool):
        raise ValueError(f"water must be True or False, not {shown(water)}")
    if topology.getNumAtoms() != system.getNumParticles():
        raise ValueError(
            f"the numbers of atoms in the Topology ({topology.getNumAtoms()}) and of particles in the System "
            f"({system.getNumParticles()}) differ: pass the Topology of this System"
        )
    left = [system.getParticleMass(i).value_in_unit(unit.dalton) for i in range(system.getNumParticles())]
    bearers = _bearers(topology)
    donors = set()
    hydrogens = [atom for atom in topology.atoms() if _is_hydrogen(atom)]
    if not hydrogens:
        raise ValueError("no atom of the Topology has the element hydrogen: set the elements of its atoms")
    for hydrogen in hydrogens:
        if left[hydrogen.index] == 0.0 or (not water and _is_water(hydrogen.residue)):
            continue  # massless atoms do not move
        if hydrogen.index not in bearers:
            raise ValueError(
                f"{_name(hydrogen)} has no bond in the Topology to a heavier atom that could supply its mass: add the "
                "bond with topology.addBond, or make the molecule's hydrogens heavier with setParticleMass"
            )
        donor = bearers[hydrogen.index]
        if left[donor.index] == 0.0:
            raise ValueError(
                f"{_name(hydrogen)} has a mass, but the bonded {_name(donor)} has none: set both masses to zero, or "
                "neither"
            )
        left[donor.index] -= wanted - left[hydrogen.index]
        left[hydrogen.index] = wanted
        donors.add(donor)
    for donor in sorted(donors, key=lambda atom: int(atom.index)):
        if left[donor.index] < wanted:
            raise ValueError(
                f"{_name(donor)} would be left with {left[donor.index]:.4g} amu, less than the {wanted:g} amu of its "
                "hydrogens: use a smaller hydrogen mass"
            )
    for i, value in enumerate(left):
        system.setParticleMass(i, value)


def _bearers(topology: app.Topology) -> dict[int, app.topology.Atom]:
    """Return the heavier atom to which each hydrogen is bonded, by the index of the hydrogen."""
    pairs = [(a, b) for bond in topology.bonds() for a, b in (bond[:2], bond[1::-1])]
    return {a.index: b for a, b in reversed(pairs) if _is_hydrogen(a) and b.element and not _is_hydrogen(b)}


def _is_hydrogen(atom: app.topology.Atom) -> bool:
    return atom.element is not None and atom.element.atomic_number == 1


def _is_water(residue: app.topology.Residue) -> bool:
    return Counter(atom.element.atomic_number for atom in residue.atoms() if atom.element is not None) == _WATER


def _name(atom: app.topology.Atom) -> str:
    return f"atom {atom.index} ({atom.name} of {atom.residue.name} {atom.residue.id})"
