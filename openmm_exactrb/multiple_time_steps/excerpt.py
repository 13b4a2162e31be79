"""The bonded forces of a System, and pairs of atoms with numbers of their own, as a System of the particles they move.

It is small compared with one with solvent, and the System of the user stays as it is.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any
from xml.etree import ElementTree

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import Part, RigidBodies
from openmm_exactrb.multiple_time_steps.bonded import BONDED_FORCES, interacting_exceptions, pairs_by_formula

Indices = NDArray[np.intp]

# The particles of a bond, an angle, a torsion or a pair of torsions in OpenMM's XML.
_PARTICLE = re.compile(r"[pab]\d")


@dataclass(frozen=True)
class Excerpt:
    """Some forces of a System.

    Attributes
    ----------
    system : openmm.System
        These forces, in their groups, and the particles that they move.
    particles : (n,) array of int
        Which particles of the whole System these are.
    part : Part
        The bodies made of them, numbered as in `system`.
    """

    system: openmm.System
    particles: Indices
    part: Part


class _BetweenBodies:
    """Which particles a force between them moves relative to each other."""

    def __init__(self, system: openmm.System, bodies: RigidBodies) -> None:
        self._owner = bodies.owner.tolist()
        self._sites = {i for i in range(system.getNumParticles()) if system.isVirtualSite(i)}

    def __call__(self, particles: Iterable[int]) -> bool:
        members = set(particles)
        owners = {self._owner[i] for i in members}
        return len(owners) > 1 and not members & self._sites


def bonded_excerpt(system: openmm.System, bodies: RigidBodies, groups: Collection[int] | None = None) -> Excerpt | None:
    """Return the bonded forces that move bodies against each other, and the exceptions of NonbondedForces that do.

    With groups, of the bonded forces those in these, and no exceptions. Without what acts on virtual sites. None if
    there are no bonded ones.
    """
    between_bodies = _BetweenBodies(system, bodies)
    forces = [force for force in system.getForces() if isinstance(force, BONDED_FORCES)]
    forces = [force for force in forces if groups is None or force.getForceGroup() in groups]
    terms = [tree for tree in map(_tree, forces) if _thinned(tree, between_bodies)]
    if not terms:
        return None
    nonbonded = [f for f in system.getForces() if groups is None and isinstance(f, openmm.NonbondedForce)]
    pairs = [(force, _interacting(force, between_bodies)) for force in nonbonded]
    touched = {i for tree in terms for term in _terms(tree) for i in _particles(term).values()}
    touched |= {i for _, of_force in pairs for pair in of_force for i in pair[:2]}
    chosen = _with_clusters(bodies, sorted(touched))
    members = np.flatnonzero(np.concatenate([chosen, [False]])[bodies.owner])  # the last is that of no body
    particles = np.union1d(members, sorted(touched)).astype(np.intp)
    number = np.full(system.getNumParticles(), -1)
    number[particles] = np.arange(len(particles))
    own = _particles_and_constraints(system, particles, number)
    for tree in terms:
        own.addForce(_numbered(tree, number))
    for force, of_force in pairs:
        if of_force:
            own.addForce(pairs_by_formula(force, [(int(number[i]), int(number[j]), *rest) for i, j, *rest in of_force]))
    own.setDefaultPeriodicBoxVectors(*system.getDefaultPeriodicBoxVectors())
    return Excerpt(own, particles, Part(bodies.chosen(chosen, number, len(particles)), chosen))


def _interacting(force: openmm.NonbondedForce, between_bodies: _BetweenBodies) -> list[tuple[Any, ...]]:
    return [pair for pair in interacting_exceptions(force) if between_bodies(pair[:2])]


def _with_clusters(bodies: RigidBodies, particles: list[int]) -> NDArray[np.bool_]:
    """Return which bodies have some of the particles, or are atoms of a cluster that has."""
    chosen = np.zeros(len(bodies) + 1, dtype=bool)
    chosen[bodies.owner[particles]] = True
    chosen = chosen[:-1]
    for _, columns in bodies.clusters.columns():
        atoms = columns + bodies.n_turning
        chosen[atoms] |= chosen[atoms].any(axis=1, keepdims=True)
    return chosen


def _particles_and_constraints(system: openmm.System, particles: Indices, number: Indices) -> openmm.System:
    own = openmm.System()
    for i in particles:
        own.addParticle(system.getParticleMass(int(i)))
    for i, j, length in map(system.getConstraintParameters, range(system.getNumConstraints())):
        if number[i] >= 0 and number[j] >= 0:
            own.addConstraint(int(number[i]), int(number[j]), length)
    return own


# -- forces as trees of XML: the same for bonds, angles and torsions of all kinds --------------------------------------


def members(force: Any) -> Iterator[tuple[int, ...]]:
    """Yield the particles of each bond, angle or torsion of a force."""
    return (tuple(_particles(term).values()) for term in _terms(_tree(force)))


def _tree(force: Any) -> ElementTree.Element:
    return ElementTree.fromstring(openmm.XmlSerializer.serialize(force))


def _particles(term: ElementTree.Element) -> dict[str, int]:
    return {name: int(term.attrib[name]) for name in _of_particles(tuple(term.attrib))}


@cache
def _of_particles(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return which attributes of a term are its particles: the same ones of all terms of a force."""
    return tuple(filter(_PARTICLE.fullmatch, names))


def _terms(tree: ElementTree.Element) -> Iterator[ElementTree.Element]:
    return (element for element in tree.iter() if _of_particles(tuple(element.attrib)))


def _thinned(tree: ElementTree.Element, between_bodies: _BetweenBodies) -> bool:
    """Remove the terms of a force that move nothing; return whether some are left."""
    for holder in list(tree.iter()):
        kept = [term for term in holder if not (own := _particles(term)) or between_bodies(own.values())]
        if len(kept) < len(holder):
            holder[:] = kept
    return any(True for _ in _terms(tree))


def _numbered(tree: ElementTree.Element, number: Indices) -> Any:
    """Return a force whose particles have other numbers."""
    for term in _terms(tree):
        for name, particle in _particles(term).items():
            term.set(name, str(number[particle]))
    return openmm.XmlSerializer.deserialize(ElementTree.tostring(tree, encoding="unicode"))
