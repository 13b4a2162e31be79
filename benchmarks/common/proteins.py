"""Solutes in water: alanine dipeptide, a PDB file, or a polyalanine helix that is built here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

from benchmarks.common.records import ROOT

PEPTIDE = ROOT / "examples" / "data" / "alanine_dipeptide.pdb"
FORCE_FIELD = "amber14-all.xml", "amber14/tip3p.xml"
# Bonds (nm), angles and torsions (degrees) of an ideal helix: C-N, N-CA, CA-C and what each new atom turns about.
BACKBONE = {"N": (0.1329, 116.6, -47.0), "CA": (0.1458, 121.7, 180.0), "C": (0.1525, 111.0, -57.0)}
# The terms of forces that are tiled, and where their parameters have the numbers of particles.
TERMS = {
    openmm.NonbondedForce: {"Particle": slice(0), "Exception": slice(2)},
    openmm.HarmonicBondForce: {"Bond": slice(2)},
    openmm.HarmonicAngleForce: {"Angle": slice(3)},
    openmm.PeriodicTorsionForce: {"Torsion": slice(4)},
    openmm.CMAPTorsionForce: {"Torsion": slice(1, 9)},
}


def solvated(file: Path, **water) -> tuple[app.Topology, unit.Quantity]:
    """Return the solute of a PDB file, with water if the file has none: a small box unless `addSolvent` is told."""
    pdb = app.PDBFile(str(file))
    model = app.Modeller(pdb.topology, pdb.positions)
    if not any(residue.name == "HOH" for residue in pdb.topology.residues()):
        box = {"boxSize": openmm.Vec3(2.1, 2.1, 2.1) * unit.nanometer}
        model.addSolvent(app.ForceField(*FORCE_FIELD), **(water or box))
    return model.topology, model.positions


def system_of(
    topology: app.Topology, force_field: tuple[str, ...] = FORCE_FIELD, constraints=app.HBonds, **settings
) -> openmm.System:
    """Return a System with PME behind a switch; `settings` are more of createSystem."""
    return app.ForceField(*force_field).createSystem(
        topology,
        nonbondedMethod=app.PME,
        nonbondedCutoff=0.85,
        switchDistance=0.75,
        constraints=constraints,
        removeCMMotion=False,
        **settings,
    )


def tiled(system: openmm.System, counts: tuple[int, int, int]) -> openmm.System:
    """Return a System of so many copies of a periodic box along each axis, particles copy after copy."""
    copies, n = int(np.prod(counts)), system.getNumParticles()
    large = openmm.System()
    vectors = system.getDefaultPeriodicBoxVectors()
    large.setDefaultPeriodicBoxVectors(*(vector * count for vector, count in zip(vectors, counts, strict=True)))
    masses = [system.getParticleMass(i) for i in range(n)]
    constraints = [system.getConstraintParameters(i) for i in range(system.getNumConstraints())]
    for first in range(0, copies * n, n):
        for mass in masses:
            large.addParticle(mass)
        for i, j, length in constraints:
            large.addConstraint(first + i, first + j, length)
    for force in system.getForces():
        large.addForce(_tiled_force(force, copies, n))
    return large


def _tiled_force(force: openmm.Force, copies: int, n: int) -> openmm.Force:
    large = openmm.XmlSerializer.clone(force)
    for term, particles in TERMS[type(force)].items():
        count = getattr(force, f"getNum{term}s")()
        terms = [getattr(force, f"get{term}Parameters")(i) for i in range(count)]
        add = getattr(large, f"add{term}")
        for first in range(n, copies * n, n):
            for parameters in terms:
                moved = list(parameters)
                moved[particles] = [first + i for i in moved[particles]]
                add(*moved)
    return large


def tiled_positions(positions: np.ndarray, vectors: np.ndarray, counts: tuple[int, int, int]) -> np.ndarray:
    """Return the positions in a tiled box, for those in a box with these vectors (3, 3)."""
    return np.concatenate([positions + np.array(cell) @ vectors for cell in np.ndindex(*counts)])


def placed(a, b, c, bond, angle, torsion):
    """Return the place of an atom by its distance to c, its angle with b and its torsion about b-c."""
    angle, torsion = np.radians(angle), np.radians(torsion)
    along = (c - b) / np.linalg.norm(c - b)
    normal = np.cross(b - a, along)
    normal /= np.linalg.norm(normal)
    frame = np.array([along, np.cross(normal, along), normal])
    turned = np.array([-np.cos(angle), np.sin(angle) * np.cos(torsion), np.sin(angle) * np.sin(torsion)])
    return c + bond * turned @ frame


def helix(residues: int) -> tuple[app.Topology, np.ndarray]:
    """Return Topology and positions (nm) of a helix of alanines with charged ends; hydrogens are missing."""
    backbone = [np.array([0.0, 0.0, 0.0]), np.array([0.1458, 0.0, 0.0]), np.array([0.2004, 0.1424, 0.0])]
    for _ in range(residues - 1):
        for geometry in BACKBONE.values():
            backbone.append(placed(*backbone[-3:], *geometry))
    backbone.append(placed(*backbone[-3:], *BACKBONE["N"]))
    topology, places = app.Topology(), []
    chain = topology.addChain()
    carbon, nitrogen, oxygen = (app.element.get_by_symbol(symbol) for symbol in "CNO")
    for i in range(residues):
        n, ca, c, following = backbone[3 * i : 3 * i + 4]
        residue = topology.addResidue("ALA", chain)
        atoms = {
            "N": (nitrogen, n),
            "CA": (carbon, ca),
            "C": (carbon, c),
            "O": (oxygen, placed(following, ca, c, 0.1231, 120.4, 180.0)),
            "CB": (carbon, placed(c, n, ca, 0.153, 110.0, -122.6)),
        }
        if i == residues - 1:
            atoms["OXT"] = (oxygen, following)
        for name, (element, place) in atoms.items():
            topology.addAtom(name, element, residue)
            places.append(place)
    topology.createStandardBonds()
    return topology, np.array(places)


def solvated_helix(residues: int) -> tuple[app.Topology, unit.Quantity]:
    """Return Topology and positions of a helix in a box of water."""
    topology, places = helix(residues)
    modeller = app.Modeller(topology, places * unit.nanometer)
    force_field = app.ForceField(*FORCE_FIELD)
    modeller.addHydrogens(force_field, platform=openmm.Platform.getPlatform("CPU"))
    modeller.addSolvent(force_field, padding=0.9 * unit.nanometer)
    return modeller.topology, modeller.positions
