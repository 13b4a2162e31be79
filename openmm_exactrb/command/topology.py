"""A Topology for a System without one, with elements that are recognised by their masses."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import openmm
from openmm import app, unit

from openmm_exactrb.openmm_access import parameters

_HYDROGEN = 1.008  # amu
_HEAVIEST = 4.5  # the largest mass of a hydrogen, in amu, in Systems with heavy hydrogens
# The largest difference in amu between the mass of a particle and that of its element, and this difference as a part of
# the mass. United atoms have no element.
_CLOSE, _CLOSE_PART = 0.01, 1e-3


def topology_of(system: openmm.System, state: openmm.State) -> app.Topology:
    """Return a topology for a System, with one residue per molecule, elements by mass, and the box of the State.

    A ValueError is raised if the particles of different molecules are interleaved.
    """
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(state.getPositions())
    molecules = context.getMolecules()
    in_order = [i for molecule in molecules for i in molecule]
    if in_order != list(range(system.getNumParticles())):  # a Topology lists one molecule after another
        raise ValueError(
            "the particles of different molecules are interleaved in the System: pass a PDB or PDBx file and "
            "--forcefield instead"
        )
    pairs, elements = _bonds(system), elements_of(system)
    topology = app.Topology()
    chain = topology.addChain()
    for molecule in molecules:
        symbols = [_symbol(system, i, elements[i]) for i in molecule]
        water = sorted(symbol for symbol in symbols if symbol != "V") == ["H", "H", "O"]
        residue = topology.addResidue("HOH" if water else "MOL", chain)
        for number, (i, symbol) in enumerate(zip(molecule, symbols, strict=True), 1):
            topology.addAtom(f"{symbol}{number}", elements[i], residue)
    atoms = list(topology.atoms())
    for first, second in pairs:
        topology.addBond(atoms[first], atoms[second])
    if system.usesPeriodicBoundaryConditions():
        topology.setPeriodicBoxVectors(state.getPeriodicBoxVectors())
    return topology


def elements_of(system: openmm.System) -> list[app.Element | None]:
    """Return the element of each particle, or None if no element has a similar mass.

    Light particles of equal mass that are bonded to one other particle, and to no others except each other, are
    hydrogens if the other particle has the mass of an element after their excess mass is returned to it; see
    `openmm_exactrb.heavy_hydrogens`. Deuterium is recognised by its mass.
    """
    masses = parameters.masses(system).tolist()
    partners = defaultdict(set)
    for i, j in _bonds(system):
        partners[i].add(j)
        partners[j].add(i)
    elements = [_element(mass) for mass in masses]
    for heavy, bonded in partners.items():
        own = [i for i in bonded if 0.0 < masses[i] < _HEAVIEST and partners[i] <= bonded | {heavy}]
        deuterated = elements[heavy] is not None and all(elements[i] == app.element.deuterium for i in own)
        if len({masses[i] for i in own}) != 1 or deuterated:
            continue
        original = _element(masses[heavy] + sum(masses[i] - _HYDROGEN for i in own))
        if original is not None and original.mass > app.element.helium.mass:
            elements[heavy] = original
            for i in own:
                elements[i] = app.element.hydrogen
    return elements


def _element(mass: float) -> app.Element | None:
    """Return the element of a mass in amu, or None if no element has a similar mass."""
    element = app.Element.getByMass(mass) if mass > 0.0 else None
    close = max(_CLOSE, _CLOSE_PART * mass)
    return element if element is not None and abs(element.mass.value_in_unit(unit.dalton) - mass) < close else None


def _symbol(system: openmm.System, particle: int, element: app.Element | None) -> str:
    if element is not None:
        return str(element.symbol)
    return "X" if system.getParticleMass(particle)._value > 0.0 else "V"


def _bonds(system: openmm.System) -> list[tuple[int, int]]:
    """Return the pairs of particles that constraints or a HarmonicBondForce join, each once."""
    bonds = [parameters.terms(force)[0] for force in system.getForces() if isinstance(force, openmm.HarmonicBondForce)]
    pairs = np.concatenate([parameters.constraints(system)[0], *bonds])
    return [*dict.fromkeys((min(pair), max(pair)) for pair in pairs.tolist())]
