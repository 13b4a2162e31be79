"""Small rigid molecules in a periodic box, as files of OpenMM, GROMACS and Amber, and a PDB with its force field."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import openmm
from openmm import app, unit

from openmm_exactrb.mathematics import quaternions

SPACING = 0.52  # nm, between molecules on a lattice


@dataclass(frozen=True)
class Molecule:
    """A rigid molecule: elements, charges, Lennard-Jones parameters by element, places in nm, and bonds."""

    name: str
    elements: tuple
    charges: tuple
    lennard_jones: dict
    places: np.ndarray
    bonds: tuple
    masses: dict = ()

    @property
    def atoms(self):
        return [f"{element}{i + 1}" for i, element in enumerate(self.elements)]

    @property
    def mass(self):
        """In amu, of each atom."""
        own = dict(self.masses)
        return [own.get(name, app.Element.getBySymbol(name).mass._value) for name in self.elements]

    @property
    def distances(self):
        """All pairs, each with its distance: more constraints than needed."""
        x, pairs = self.places, itertools.combinations(range(len(self.places)), 2)
        return [(i, j, float(np.linalg.norm(x[i] - x[j]))) for i, j in pairs]


def _star(arms, length):
    return np.concatenate([np.zeros((1, 3)), length * np.array(arms) / np.linalg.norm(arms[0])])


def _ring(radius):
    angles = np.arange(6) * math.pi / 3.0
    return radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])


_TETRAHEDRON = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
_OCTAHEDRON = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
_ANGLE = math.radians(108.5)
_METHANOL = np.array([[0.143, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0945 * math.cos(_ANGLE), 0.0945 * math.sin(_ANGLE), 0.0]])

#: By name: models of EPM2, TraPPE and OPLS.
MOLECULES = {
    molecule.name: molecule
    for molecule in (
        Molecule(
            "CO2",
            ("C", "O", "O"),
            (0.6512, -0.3256, -0.3256),
            {"C": (0.2757, 0.2339), "O": (0.3033, 0.6694)},
            _star([(1, 0, 0), (-1, 0, 0)], 0.1149),
            ((0, 1), (0, 2)),
        ),
        Molecule("N2", ("N", "N"), (0.0, 0.0), {"N": (0.331, 0.2993)}, _star([(1, 0, 0)], 0.11), ((0, 1),)),
        Molecule(
            "CH4",
            ("C", "H", "H", "H", "H"),
            (-0.24, 0.06, 0.06, 0.06, 0.06),
            {"C": (0.35, 0.2761), "H": (0.25, 0.1255)},
            _star(_TETRAHEDRON, 0.109),
            ((0, 1), (0, 2), (0, 3), (0, 4)),
        ),
        Molecule(
            "SF6",
            ("S", *6 * ("F",)),
            7 * (0.0,),
            {"S": (0.3228, 1.3706), "F": (0.2947, 0.2268)},
            _star(_OCTAHEDRON, 0.1565),
            tuple((0, i) for i in range(1, 7)),
        ),
        Molecule(
            "C6H6",
            (*6 * ("C",), *6 * ("H",)),
            (*6 * (-0.115,), *6 * (0.115,)),
            {"C": (0.355, 0.2929), "H": (0.242, 0.1255)},
            np.concatenate([_ring(0.14), _ring(0.248)]),
            (*((i, (i + 1) % 6) for i in range(6)), *((i, i + 6) for i in range(6))),
        ),
        Molecule(
            "MEOH",
            ("C", "O", "H"),
            (0.265, -0.7, 0.435),
            {"C": (0.375, 0.8148), "O": (0.302, 0.7732), "H": (1.0, 0.0)},
            _METHANOL,
            ((0, 1), (1, 2)),
            (("C", 15.035),),
        ),
    )
}


def placed(molecule, n, seed=1):
    """Return positions (n * k, 3) of molecules turned at random on a lattice, and the edge of their box."""
    rng, side = np.random.default_rng(seed), math.ceil(n ** (1 / 3))
    spacing = SPACING + 0.5 * np.ptp(molecule.places, axis=0).max()
    centres = spacing * np.array(list(itertools.product(range(side), repeat=3))[:n])
    turned = [molecule.places @ quaternions.rotation_matrix(q).T for q in quaternions.random(rng, n)]
    return (np.array(turned) + centres[:, None, :]).reshape(-1, 3), side * spacing


def topology_of(molecule, n):
    topology = app.Topology()
    chain = topology.addChain()
    for _ in range(n):
        residue = topology.addResidue(molecule.name[:3], chain)
        pairs = zip(molecule.atoms, molecule.elements, strict=True)
        atoms = [topology.addAtom(name, app.Element.getBySymbol(element), residue) for name, element in pairs]
        for i, j in molecule.bonds:
            topology.addBond(atoms[i], atoms[j])
    return topology


def system_of(molecule, n, edge, cutoff=0.9, tolerance=1e-5):
    """Return a System with all distances within molecules constrained, PME and a switched cutoff."""
    system, force = openmm.System(), openmm.NonbondedForce()
    system.setDefaultPeriodicBoxVectors(*(edge * np.eye(3)))
    for k in range(n):
        first = k * len(molecule.elements)
        for element, mass, charge in zip(molecule.elements, molecule.mass, molecule.charges, strict=True):
            system.addParticle(mass)
            force.addParticle(charge, *molecule.lennard_jones[element])
        for i, j, distance in molecule.distances:
            system.addConstraint(first + i, first + j, distance)
            force.addException(first + i, first + j, 0.0, 1.0, 0.0)
    force.setNonbondedMethod(force.PME)
    force.setCutoffDistance(cutoff)
    force.setUseSwitchingFunction(True)
    force.setSwitchingDistance(cutoff - 0.1)
    force.setEwaldErrorTolerance(tolerance)
    system.addForce(force)
    return system


def as_xml(molecule, n, folder, cutoff=0.7, tolerance=1e-3):
    """Write a System and a State without velocities; return their names."""
    x, edge = placed(molecule, n)
    system = system_of(molecule, n, edge, cutoff, tolerance)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(x)
    files = folder / "system.xml", folder / "state.xml"
    state = context.getState(positions=True)
    for file, content in zip(files, (system, state), strict=True):
        file.write_text(openmm.XmlSerializer.serialize(content))
    return list(files)


def as_pdb(molecule, n, folder):
    """Write a PDB file and a force field that constrains all distances; return what names them."""
    x, edge = placed(molecule, n)
    topology = topology_of(molecule, n)
    topology.setPeriodicBoxVectors(edge * np.eye(3) * unit.nanometer)
    files = folder / "box.pdb", folder / "molecule.xml"
    with files[0].open("w") as out:
        app.PDBFile.writeFile(topology, x * unit.nanometer, out)
    atoms = list(zip(molecule.atoms, molecule.elements, molecule.mass, molecule.charges, strict=True))
    types = "".join(f'<Type name="{a}" class="{a}" element="{e}" mass="{m}"/>' for a, e, m, _ in atoms)
    own = "".join(f'<Atom name="{a}" type="{a}" charge="{q}"/>' for a, _, _, q in atoms)
    bonds = "".join(
        f'<Bond atomName1="{molecule.atoms[i]}" atomName2="{molecule.atoms[j]}"/>' for i, j in molecule.bonds
    )
    pairs = "".join(
        f'<Atom type="{a}" sigma="{molecule.lennard_jones[e][0]}" epsilon="{molecule.lennard_jones[e][1]}"/>'
        for a, e, _, _ in atoms
    )
    constraints = "".join(
        f'<Constraint atomName1="{molecule.atoms[i]}" atomName2="{molecule.atoms[j]}" distance="{distance}"/>'
        for i, j, distance in molecule.distances
    )
    files[1].write_text(
        f'<ForceField><AtomTypes>{types}</AtomTypes><Residues><Residue name="{molecule.name[:3]}">{own}{bonds}'
        f'{constraints}</Residue></Residues><NonbondedForce coulomb14scale="0.833333" lj14scale="0.5">'
        f'<UseAttributeFromResidue name="charge"/>{pairs}</NonbondedForce></ForceField>\n'
    )
    return [files[0], "--forcefield", files[1]]


def as_mixture(molecule, n, folder):
    """Write the same with every other molecule replaced by TIP4P water, whose sites the force field adds."""
    files = as_pdb(molecule, n, folder)
    content = app.PDBFile(str(files[0]))
    modeller = app.Modeller(content.topology, content.positions)
    replaced = list(content.topology.residues())[::2]
    centres = np.array(content.positions._value)[[next(residue.atoms()).index for residue in replaced]]
    modeller.delete(replaced)
    water = app.Topology()
    chain, oxygen, hydrogen = water.addChain(), app.element.oxygen, app.element.hydrogen
    for _ in replaced:
        residue = water.addResidue("HOH", chain)
        o, *h = (water.addAtom(name, e, residue) for name, e in (("O", oxygen), ("H1", hydrogen), ("H2", hydrogen)))
        for atom in h:
            water.addBond(o, atom)
    places = np.array([[0.0, 0.0, 0.0], [0.07569, 0.0, 0.05859], [-0.07569, 0.0, 0.05859]])
    modeller.add(water, (centres[:, None] + places).reshape(-1, 3) * unit.nanometer)
    with files[0].open("w") as out:
        app.PDBFile.writeFile(modeller.topology, modeller.positions, out)
    return [*files, "tip4pew.xml"]


def as_gromacs(molecule, n, folder):
    """Write a gro and a top file, which constrains all distances; return their names."""
    x, edge = placed(molecule, n)
    k, name = len(molecule.elements), molecule.name[:3]
    rows = [
        f"{i // k + 1:5d}{name:<5s}{molecule.atoms[i % k]:>5s}{i + 1:5d}" + "".join(f"{value:8.3f}" for value in place)
        for i, place in enumerate(x)
    ]
    files = folder / "box.gro", folder / "box.top"
    files[0].write_text("\n".join(["small molecules", f"{n * k:5d}", *rows, 3 * f"{edge:10.5f}", ""]))
    parts = zip(molecule.elements, molecule.mass, strict=True)
    types = dict(parts)
    lines = ["[ defaults ]", "1 2 no 1.0 1.0", "[ atomtypes ]"]
    for element, mass in types.items():
        number = app.Element.getBySymbol(element).atomic_number
        sigma, epsilon = molecule.lennard_jones[element]
        lines.append(f"X{element} {number} {mass} 0.0 A {sigma} {epsilon}")
    lines += ["[ moleculetype ]", f"{name} 3", "[ atoms ]"]
    for i, (element, charge) in enumerate(zip(molecule.elements, molecule.charges, strict=True), 1):
        lines.append(f"{i} X{element} 1 {name} {molecule.atoms[i - 1]} 1 {charge}")
    lines += ["[ constraints ]", *(f"{i + 1} {j + 1} 1 {distance:.9f}" for i, j, distance in molecule.distances)]
    lines.append("[ exclusions ]")
    lines += [" ".join(str(j) for j in (i, *(j for j in range(1, k + 1) if j != i))) for i in range(1, k + 1)]
    lines += ["[ system ]", "small", "[ molecules ]", f"{name} {n}", ""]
    files[1].write_text("\n".join(lines))
    return list(files)


def _section(flag, form, values):
    """Return a section of a prmtop file."""
    per_line, text = {"a": (20, "{:<4s}"), "I": (10, "{:8d}"), "E": (5, "{:16.8E}")}[form]
    shown = {"a": "20a4", "I": "10I8", "E": "5E16.8"}[form]
    rows = ["".join(text.format(v) for v in values[i : i + per_line]) for i in range(0, len(values), per_line)] or [""]
    return [f"%FLAG {flag}", f"%FORMAT({shown})", *rows]


def as_amber(molecule, n, folder):
    """Write a prmtop and an inpcrd file without constraints, which options add; return their names."""
    x, edge = placed(molecule, n)
    lines = ["%VERSION  VERSION_STAMP = V0001.000  DATE = 01/01/00  00:00:00"]
    for section in _prmtop(molecule, n, edge):
        lines += _section(*section)
    files = folder / "box.prmtop", folder / "box.inpcrd"
    files[0].write_text("\n".join([*lines, ""]))
    numbers = [f"{10.0 * value:12.7f}" for value in x.ravel()]
    rows = ["".join(numbers[i : i + 6]) for i in range(0, len(numbers), 6)]
    box = "".join(f"{v:12.7f}" for v in [10.0 * edge] * 3 + [90.0] * 3)
    files[1].write_text("\n".join(["box", f"{len(x):5d}", *rows, box, ""]))
    return list(files)


def _prmtop(molecule, n, edge):
    """Return the sections that OpenMM reads; all terms are among those without hydrogen."""
    k, kinds = len(molecule.elements), list(dict.fromkeys(molecule.elements))
    angles = _angles(molecule)
    lengths = [float(np.linalg.norm(molecule.places[i] - molecule.places[j])) * 10.0 for i, j in molecule.bonds]
    pairs = [(a, b) for b in range(len(kinds)) for a in range(b + 1)]
    number = {pair: i + 1 for i, pair in enumerate(pairs)}
    table = [number[min(a, b), max(a, b)] for a in range(len(kinds)) for b in range(len(kinds))]
    of_pairs = [_lennard_jones(molecule, kinds[a], kinds[b]) for a, b in pairs]
    excluded = [m * k + j + 1 for m in range(n) for i in range(k) for j in ([*range(i + 1, k)] or [-m * k - 1])]
    pointers = {0: n * k, 1: len(kinds), 3: n * len(lengths), 5: n * len(angles), 10: len(excluded), 11: n}
    pointers |= {12: n * len(lengths), 13: n * len(angles), 15: len(lengths), 16: len(angles), 18: len(kinds)}
    pointers |= {27: 1, 28: k}

    def terms(chosen):
        return [v for m in range(n) for t, of in enumerate(chosen) for v in (*(3 * (m * k + i) for i in of), t + 1)]

    return [
        ("TITLE", "a", ["box"]),
        ("POINTERS", "I", [pointers.get(i, 0) for i in range(31)]),
        ("ATOM_NAME", "a", n * molecule.atoms),
        ("CHARGE", "E", n * [18.2223 * q for q in molecule.charges]),
        ("ATOMIC_NUMBER", "I", n * [app.Element.getBySymbol(e).atomic_number for e in molecule.elements]),
        ("MASS", "E", n * molecule.mass),
        ("ATOM_TYPE_INDEX", "I", n * [kinds.index(e) + 1 for e in molecule.elements]),
        ("NUMBER_EXCLUDED_ATOMS", "I", n * [max(1, k - i - 1) for i in range(k)]),
        ("NONBONDED_PARM_INDEX", "I", table),
        ("RESIDUE_LABEL", "a", n * [molecule.name[:3]]),
        ("RESIDUE_POINTER", "I", [m * k + 1 for m in range(n)]),
        ("BOND_FORCE_CONSTANT", "E", len(lengths) * [400.0]),
        ("BOND_EQUIL_VALUE", "E", lengths),
        ("ANGLE_FORCE_CONSTANT", "E", len(angles) * [50.0]),
        ("ANGLE_EQUIL_VALUE", "E", [_bend(molecule.places[list(of)]) for of in angles]),
        *((f"DIHEDRAL_{name}", "E", []) for name in ("FORCE_CONSTANT", "PERIODICITY", "PHASE")),
        *((name, "E", []) for name in ("SCEE_SCALE_FACTOR", "SCNB_SCALE_FACTOR", "HBOND_ACOEF", "HBOND_BCOEF")),
        ("LENNARD_JONES_ACOEF", "E", [a for a, _ in of_pairs]),
        ("LENNARD_JONES_BCOEF", "E", [b for _, b in of_pairs]),
        ("BONDS_WITHOUT_HYDROGEN", "I", terms(molecule.bonds)),
        ("ANGLES_WITHOUT_HYDROGEN", "I", terms(angles)),
        *((f"{kind}_INC_HYDROGEN", "I", []) for kind in ("BONDS", "ANGLES", "DIHEDRALS")),
        ("DIHEDRALS_WITHOUT_HYDROGEN", "I", []),
        ("EXCLUDED_ATOMS_LIST", "I", excluded),
        ("AMBER_ATOM_TYPE", "a", n * list(molecule.elements)),
        ("SOLVENT_POINTERS", "I", [0, n, 1]),
        ("ATOMS_PER_MOLECULE", "I", n * [k]),
        ("BOX_DIMENSIONS", "E", [90.0, 10.0 * edge, 10.0 * edge, 10.0 * edge]),
    ]


def _angles(molecule):
    """Return the three atoms of each angle between two bonds."""
    directed = [*molecule.bonds, *((j, i) for i, j in molecule.bonds)]
    pairs = itertools.permutations(directed, 2)
    return [(i, m, j) for (i, m), (j, o) in pairs if m == o and i < j]


def _bend(places):
    a, b = places[0] - places[1], places[2] - places[1]
    return float(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1.0, 1.0)))


def _lennard_jones(molecule, one, other):
    """Return the coefficients of r⁻¹² and r⁻⁶ in kcal/mol and Å."""
    (s, e), (t, f) = molecule.lennard_jones[one], molecule.lennard_jones[other]
    radius, depth = 5.0 * (s + t), math.sqrt(e * f) / 4.184  # sigma of both in Å
    return 4.0 * depth * radius**12, 4.0 * depth * radius**6
