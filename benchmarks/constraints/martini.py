"""Martini 2 bilayers of DPPC or DIPC, cholesterol and water, built from published parameters only.

Interaction levels, bead types and lipids are those of S. J. Marrink et al. (2007), doi:10.1021/jp071097f; DIPC has the
C4 beads of doi:10.1021/acs.jctc.5b00209. Cholesterol has three virtual sites and two hinged triangles of constraints:
M. N. Melo, H. I. Ingolfsson and S. J. Marrink (2015), doi:10.1063/1.4937783, topology of May 2014. The cutoff is 1.1
nm, with the Lennard-Jones potential shifted to zero there, and a reaction field with a dielectric constant of 15 within
the cutoff and infinity beyond: D. H. de Jong et al. (2016), doi:10.1016/j.cpc.2015.09.014.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import openmm
from openmm import app, unit

#: Strengths of the levels O and I to IX in kJ/mol. Beads are 0.47 nm wide, at level IX, charges in oil, 0.62 nm. Ring
#: beads have 3/4 of the strength among themselves, and 0.43 nm.
LEVELS = (5.6, 5.0, 4.5, 4.0, 3.5, 3.1, 2.7, 2.3, 2.0, 2.0)
TYPES = ["P4", "Na", "Q0", "Qa", "C1", "C4", "SP1", "SC1", "SC3"]
#: The level of each pair of types, a row to its diagonal.
PAIRS = ("1", "33", "034", "0321", "86994", "656654", "2231642", "86994564", "667744444")
CUTOFF, DIELECTRIC = 1.1, 15.0
_COULOMB = 138.935456  # kJ/mol nm/e²


@dataclass(frozen=True)
class Molecule:
    """Beads (name, type, mass, charge) and what acts within a molecule, by their numbers."""

    beads: tuple
    places: np.ndarray  # nm; the water side is up
    bonds: tuple = ()  # i, j, nm, kJ/mol/nm²
    angles: tuple = ()  # i, j, k, degrees, kJ/mol
    constraints: tuple = ()
    exclusions: tuple = ()


def lipid(tail):
    """Return a phosphatidylcholine whose two tails have these four types, such as "C1 C4 C4 C1"."""
    types = ("Q0", "Qa", "Na", "Na", *2 * tail.split())
    names = ("NC3", "PO4", "GL1", "GL2", *(f"C{k}{chain}" for chain in "AB" for k in (1, 2, 3, 4)))
    beads = tuple((n, t, 72.0, {"Q0": 1.0, "Qa": -1.0}.get(t, 0.0)) for n, t in zip(names, types, strict=True))
    bonds = [(0, 1, 0.47), (1, 2, 0.47), (2, 3, 0.37), (2, 4, 0.47), (3, 8, 0.47)]
    bonds += [(k, k + 1, 0.47) for k in (4, 5, 6, 8, 9, 10)]
    angles = [(1, 2, 3, 120.0, 25.0), (1, 2, 4, 180.0, 25.0)]
    for chain in ((2, 4, 5, 6, 7), (3, 8, 9, 10, 11)):
        for k in range(3):
            kinked = {("C1", "C4", "C4"): (100.0, 10.0), ("C4", "C4", "C1"): (120.0, 45.0)}
            angle = kinked.get(tuple(types[i] for i in chain[k : k + 3]), (180.0, 25.0))
            angles.append((*chain[k : k + 3], *angle))
    z = 0.45 * np.array([5, 4, 3, 3, 2, 1, 0, -1, 2, 1, 0, -1])
    x = np.array([0, 0, 0, 0.37, *4 * [0], *4 * [0.37]]) - 0.185
    places = np.column_stack([x, 0.0 * x, z + 0.7])
    return Molecule(beads, places, tuple((*b, 1250.0) for b in bonds), tuple(angles))


def _cholesterol():
    names = ("ROH", "R1", "R2", "R3", "R4", "R5", "C1", "C2")
    types = ("SP1", "SC1", "SC3", "SC1", "SC1", "SC1", "SC1", "C1")
    masses = (77.22, 0.0, 38.69, 159.65, 0.0, 0.0, 39.44, 72.0)
    beads = tuple((n, t, m, 0.0) for n, t, m in zip(names, types, masses, strict=True))
    constraints = ((0, 2, 0.4904), (0, 3, 0.6019), (2, 3, 0.2719), (6, 2, 0.7237), (6, 3, 0.5376))
    frame = np.zeros((8, 2))  # all constraints in one plane, R2 at the origin
    frame[3] = 0.2719, 0.0
    for bead, to_2, to_3, side in ((0, 0.4904, 0.6019, 1), (6, 0.7237, 0.5376, -1)):
        along = (to_2**2 - to_3**2 + 0.2719**2) / (2 * 0.2719)
        frame[bead] = along, side * np.sqrt(to_2**2 - along**2)
    frame[7] = frame[6] + 0.425 * (frame[6] - frame[3]) / np.linalg.norm(frame[6] - frame[3])
    up = (frame[0] - frame[6]) / np.linalg.norm(frame[0] - frame[6])
    places = np.column_stack([frame @ [up[1], -up[0]], np.zeros(8), frame @ up])
    places += [0.0, 0.0, 1.9 - places[0, 2]]
    exclusions = tuple((i, j) for j in range(7) for i in range(j))
    return Molecule(beads, places, ((6, 7, 0.425, 1250.0),), ((3, 6, 7, 180.0, 25.0),), constraints, exclusions)


MOLECULES = {
    "DPPC": lipid("C1 C1 C1 C1"),
    "DIPC": lipid("C1 C4 C4 C1"),
    "CHOL": _cholesterol(),
    "W": Molecule((("W", "P4", 72.0, 0.0),), np.zeros((1, 3))),
}


def virtual_sites(system, first):
    """Give a cholesterol from a particle on its three virtual sites."""
    ROH, R2, R3, C1 = first, first + 2, first + 3, first + 6
    # GROMACS builds its sites 3 from a first particle and two vectors, as OpenMM does.
    for site, frame, weights in (
        (1, (R2, ROH, R3), (0.5207, 0.2882, -0.83824)),
        (4, (R3, R2, C1), (0.9613, 0.6320, 0.0)),
        (5, (R3, R2, C1), (0.2287, 0.4111, 1.1531)),
    ):
        system.setVirtualSite(first + site, openmm.OutOfPlaneSite(*frame, *weights))


def lennard_jones():
    """Return the strengths (kJ/mol) and sizes (nm) of all pairs of types, two matrices."""
    n = len(TYPES)
    strength, size = np.zeros((n, n)), np.zeros((n, n))
    for i, row in enumerate(PAIRS):
        for j, level in enumerate(row):
            rings = TYPES[i].startswith("S") and TYPES[j].startswith("S")
            strength[i, j] = strength[j, i] = (0.75 if rings else 1.0) * LEVELS[int(level)]
            size[i, j] = size[j, i] = 0.43 if rings else 0.62 if level == "9" else 0.47
    return strength, size


def _factors(matrix):
    """Return signs and rows with matrix[i, j] = sum of sign rows[i] rows[j], as many as its rank."""
    values, vectors = np.linalg.eigh(matrix)
    kept = np.abs(values) > 1e-12 * np.abs(values).max()
    return np.sign(values[kept]), vectors[:, kept] * np.sqrt(np.abs(values[kept]))


def _product(name, signs):
    return " ".join(f"{'+-'[int(sign < 0)]} {name}{k}1*{name}{k}2" for k, sign in enumerate(signs)).lstrip("+ ")


def _pairs(molecules):
    """Return the nonbonded forces of molecules in order, the electric ones between charges alone.

    The matrices of the pairs enter as products of numbers of each particle: OpenMM's CPU platform takes five times as
    long with tables.
    """
    strength, size = lennard_jones()
    c6, others = 4.0 * strength * size**6, 4.0 * strength * size**6 * (size**6 - 0.47**6)
    (signs, rows), (other_signs, other_rows) = _factors(c6), _factors(others)
    force = openmm.CustomNonbondedForce(
        f"(c6*{0.47**6} + c12)*(s*s - {CUTOFF**-12}) - c6*(s - {CUTOFF**-6}); c6 = {_product('u', signs)};"
        f"c12 = {_product('w', other_signs)}; s = 1/(r2*r2*r2); r2 = r*r"
    )
    for letter, factors in (("u", signs), ("w", other_signs)):
        for k in range(len(factors)):
            force.addPerParticleParameter(f"{letter}{k}")
    parameters = np.hstack([rows, other_rows])
    field, constant = 0.5 / CUTOFF**3, 1.5 / CUTOFF
    electric = openmm.CustomNonbondedForce(f"{_COULOMB / DIELECTRIC}*q1*q2*(1/r + {field}*r*r - {constant})")
    electric.addPerParticleParameter("q")
    within = openmm.CustomBondForce(f"{_COULOMB / DIELECTRIC}*qq*({field}*r*r - {constant})")  # as GROMACS has it
    within.addPerBondParameter("qq")
    first, charged = 0, []
    for name in molecules:
        molecule = MOLECULES[name]
        for k, (_, kind, _, charge) in enumerate(molecule.beads):
            force.addParticle(parameters[TYPES.index(kind)])
            electric.addParticle([charge])
            if charge:
                charged.append(first + k)
        for i, j in molecule.exclusions or [bond[:2] for bond in molecule.bonds]:
            force.addExclusion(first + i, first + j)
            electric.addExclusion(first + i, first + j)
            charges = molecule.beads[i][3] * molecule.beads[j][3]
            if charges:
                within.addBond(first + i, first + j, [charges])
        if name == "CHOL":
            force.addExclusion(first + 6, first + 7)
            electric.addExclusion(first + 6, first + 7)
        first += len(molecule.beads)
    electric.addInteractionGroup(charged, charged)
    for pairs in (force, electric):
        pairs.setNonbondedMethod(openmm.CustomNonbondedForce.CutoffPeriodic)
        pairs.setCutoffDistance(CUTOFF)
    within.setUsesPeriodicBoundaryConditions(True)
    return [force, electric, within] if charged else [force]


def _bonded(molecules):
    bonds = openmm.HarmonicBondForce()
    angles = openmm.CustomAngleForce("0.5*k*(cos(theta) - cos0)^2")
    improper = openmm.CustomTorsionForce(
        "0.5*50*d*d; d = t - 2*pi*floor(t/(2*pi) + 0.5); t = theta - t0; pi = 3.14159265358979"
    )
    improper.addGlobalParameter("t0", np.radians(-179.7))
    for parameter in ("k", "cos0"):
        angles.addPerAngleParameter(parameter)
    first = 0
    for name in molecules:
        molecule = MOLECULES[name]
        for i, j, length, k in molecule.bonds:
            bonds.addBond(first + i, first + j, length, k)
        for i, j, l, angle, k in molecule.angles:
            angles.addAngle(first + i, first + j, first + l, [k, np.cos(np.radians(angle))])
        if name == "CHOL":
            improper.addTorsion(first, first + 2, first + 3, first + 6, [])
        first += len(molecule.beads)
    for force in (bonds, angles, improper):
        force.setUsesPeriodicBoundaryConditions(True)
    return [bonds, angles, improper]


def system_of(molecules, box):
    """Return Topology and System of molecules, named in their order, in a box (nm, three edges)."""
    topology, system = app.Topology(), openmm.System()
    chain = topology.addChain()
    for name in molecules:
        molecule, first = MOLECULES[name], system.getNumParticles()
        residue = topology.addResidue(name, chain)
        atoms = [topology.addAtom(bead[0], None, residue) for bead in molecule.beads]
        for bead in molecule.beads:
            system.addParticle(bead[2])
        for i, j, length in molecule.constraints:
            system.addConstraint(first + i, first + j, length)
        for i, j, *_ in (*molecule.bonds, *molecule.constraints):
            topology.addBond(atoms[i], atoms[j])
        if name == "CHOL":
            virtual_sites(system, first)
    for force in (*_bonded(molecules), *_pairs(molecules)):
        system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*np.diag(box))
    topology.setUnitCellDimensions(unit.Quantity(tuple(box), unit.nanometer))
    return topology, system


def bilayer(composition, per_side=8, water=6.0, area=0.64, seed=1):
    """Return Topology, System and positions (nm) of a bilayer on a lattice.

    Parameters
    ----------
    composition : dict
        Parts of the molecules in both leaflets, such as {"DPPC": 0.7, "CHOL": 0.3}.
    per_side : int
        Molecules along an edge of a leaflet.
    water : float
        Beads of water a molecule of the membrane.
    area : float
        Of a molecule, in nm².
    """
    rng, n = np.random.default_rng(seed), per_side**2
    edge = per_side * np.sqrt(area)
    lattice = np.stack(np.meshgrid(*2 * [(np.arange(per_side) + 0.5) * edge / per_side]), axis=-1).reshape(-1, 2)
    molecules, places = [], []
    for side in (1.0, -1.0):
        counts = np.round(np.array(list(composition.values())) * n).astype(int)
        counts[0] += n - counts.sum()
        for name, at in zip(rng.permutation(np.repeat(list(composition), counts)).tolist(), lattice, strict=True):
            x = MOLECULES[name].places * [1.0, side, side]
            turn = rng.uniform(0.0, 2.0 * np.pi)
            turned = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
            molecules.append(name)
            places.append(np.column_stack([x[:, :2] @ np.transpose(turned) + at, x[:, 2]]))
    half = 3.2
    columns = int(edge / 0.5)
    layers = int(np.ceil(2 * n * water / columns**2))
    grid = np.stack(np.meshgrid(*2 * [(np.arange(columns) + 0.5) * edge / columns], np.arange(layers)), axis=-1)
    grid = grid.reshape(-1, 3) * [1.0, 1.0, 0.5] + [0.0, 0.0, half]
    for x in rng.permutation(grid)[: round(2 * n * water)]:
        molecules.append("W")
        places.append(x[None])
    order = sorted(range(len(molecules)), key=lambda k: list(MOLECULES).index(molecules[k]))
    molecules = [molecules[k] for k in order]
    box = np.array([edge, edge, 2 * half + 0.5 * (layers - 1)])
    topology, system = system_of(molecules, box)
    return topology, system, np.concatenate([places[k] for k in order])


def relax(integrator, step, friction):
    """Take the overlaps out of a lattice by short steps with much friction, then set step (ps) and friction (1/ps).

    OpenMM's minimiser calls the constraint solver that does not converge for cholesterol.
    """
    for h, g in ((1e-4, 5000.0), (1e-3, 1000.0), (5e-3, 100.0), (1e-2, 20.0)):
        integrator.setStepSize(h)
        integrator.setFriction(g)
        integrator.step(100)
    integrator.setStepSize(step)
    integrator.setFriction(friction)
