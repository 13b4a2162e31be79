"""The files in which other programs keep a box of TIP3P."""

import numpy as np

# Parameters of TIP3P in the units of the programs: angstrom, kcal/mol, e.
CHARGES, MASSES, TYPES = (-0.834, 0.417, 0.417), (15.999, 1.008, 1.008), (1, 2, 2)
NAMES, KINDS = ("O", "H1", "H2"), ("OW", "HW", "HW")
LENGTH, ACROSS, ANGLE = 0.9572, 1.513900654, 104.52
EPSILON, RADIUS = 0.1521, 1.7682927  # of the minimum, between the centres and halved
CHARGE_OF_AMBER = 18.2223


def amber(folder, x, side):
    """Write prmtop and inpcrd of positions (3 n, 3) in a cubic box, in angstrom; return their paths."""
    n = len(x) // 3
    first = np.arange(1, 3 * n + 1, 3)
    A, B = EPSILON * (2 * RADIUS) ** 12, 2 * EPSILON * (2 * RADIUS) ** 6
    at = 3 * (first - 1)
    bonds = np.stack([[at, at + 3, at * 0 + 1], [at, at + 6, at * 0 + 1], [at + 3, at + 6, at * 0 + 2]])
    excluded = np.stack([first + 1, first + 2, first + 2, first * 0], axis=1)
    pointers = np.zeros(31, dtype=int)
    pointers[:4], pointers[10:12], pointers[15], pointers[18] = (3 * n, 2, 3 * n, 0), (4 * n, n), 2, 2
    pointers[[27, 28]] = 1, 3
    sections = [
        ("TITLE", "20a4", ["water"]),
        ("POINTERS", "10I8", pointers),
        ("ATOM_NAME", "20a4", NAMES * n),
        ("CHARGE", "5E16.8", np.array(CHARGES * n) * CHARGE_OF_AMBER),
        ("MASS", "5E16.8", MASSES * n),
        ("ATOM_TYPE_INDEX", "10I8", TYPES * n),
        ("NUMBER_EXCLUDED_ATOMS", "10I8", (2, 1, 1) * n),
        ("NONBONDED_PARM_INDEX", "10I8", (1, 2, 2, 3)),
        ("RESIDUE_LABEL", "20a4", ["WAT"] * n),
        ("RESIDUE_POINTER", "10I8", first),
        ("BOND_FORCE_CONSTANT", "5E16.8", (553.0, 553.0)),
        ("BOND_EQUIL_VALUE", "5E16.8", (LENGTH, ACROSS)),
        ("LENNARD_JONES_ACOEF", "5E16.8", (A, 0.0, 0.0)),
        ("LENNARD_JONES_BCOEF", "5E16.8", (B, 0.0, 0.0)),
        ("BONDS_INC_HYDROGEN", "10I8", bonds.transpose(2, 0, 1).ravel()),
        ("EXCLUDED_ATOMS_LIST", "10I8", excluded.ravel()),
        ("AMBER_ATOM_TYPE", "20a4", KINDS * n),
        ("BOX_DIMENSIONS", "5E16.8", (90.0, side, side, side)),
    ]
    empty = """ANGLE_FORCE_CONSTANT ANGLE_EQUIL_VALUE DIHEDRAL_FORCE_CONSTANT DIHEDRAL_PERIODICITY DIHEDRAL_PHASE
        HBOND_ACOEF HBOND_BCOEF BONDS_WITHOUT_HYDROGEN ANGLES_INC_HYDROGEN ANGLES_WITHOUT_HYDROGEN
        DIHEDRALS_INC_HYDROGEN DIHEDRALS_WITHOUT_HYDROGEN"""
    sections += [(name, "5E16.8", ()) for name in empty.split()]
    prmtop, inpcrd = folder / "water.prmtop", folder / "water.inpcrd"
    head = "%VERSION  VERSION_STAMP = V0001.000  DATE = 01/01/26  00:00:00\n"
    prmtop.write_text(head + "".join(f"%FLAG {name}\n%FORMAT({form})\n{_rows(form, v)}" for name, form, v in sections))
    box = np.array([side] * 3 + [90.0] * 3)
    inpcrd.write_text(f"water\n{3 * n:5d}\n{_rows('6F12.7', np.ravel(x))}{_rows('6F12.7', box)}")
    return prmtop, inpcrd


def charmm(folder, x):
    """Write psf, crd, rtf and prm of positions (3 n, 3) in angstrom; return their paths."""
    n = len(x) // 3
    atoms = list(enumerate(zip(("OH2", "H1", "H2") * n, ("OT", "HT", "HT") * n, CHARGES * n, MASSES * n, strict=True)))
    psf, crd, rtf, prm = (folder / f"water.{suffix}" for suffix in ("psf", "crd", "rtf", "prm"))
    first = np.arange(1, 3 * n + 1, 3)
    bonds = np.stack([first, first + 1, first, first + 2, first + 1, first + 2], axis=1).ravel()
    angles = np.stack([first + 1, first, first + 2], axis=1).ravel()
    psf.write_text(
        f"PSF\n\n{1:8d} !NTITLE\n REMARKS water\n\n{3 * n:8d} !NATOM\n"
        + "".join(
            f"{i + 1:8d} WAT  {i // 3 + 1:<4d} TIP3 {name:<4s} {kind:<4s} {charge:10.6f} {mass:13.4f} {0:11d}\n"
            for i, (name, kind, charge, mass) in atoms
        )
        + f"\n{3 * n:8d} !NBOND: bonds\n{_rows('8I8', bonds)}\n{n:8d} !NTHETA: angles\n{_rows('9I8', angles)}"
        + "".join(f"\n{0:8d} !{name}\n\n" for name in ("NPHI: dihedrals", "NIMPHI: impropers", "NDON", "NACC", "NNB"))
    )
    crd.write_text(
        f"* water\n*\n{3 * n:5d}\n"
        + "".join(
            f"{i + 1:5d}{i // 3 + 1:5d} TIP3 {name:<4s}{x[i][0]:10.5f}{x[i][1]:10.5f}{x[i][2]:10.5f} WAT  "
            f"{i // 3 + 1:<4d}{0:10.5f}\n"
            for i, (name, *_) in atoms
        )
    )
    rtf.write_text(f"* water\n*\n36 1\n\nMASS 1 OT {MASSES[0]} O\nMASS 2 HT {MASSES[1]} H\n\nEND\n")
    prm.write_text(
        f"* water\n*\n\nBONDS\nOT HT 450.0 {LENGTH}\nHT HT 0.0 {ACROSS}\n\nANGLES\nHT OT HT 55.0 {ANGLE}\n\n"
        f"NONBONDED\nOT 0.0 -{EPSILON} {RADIUS}\nHT 0.0 0.0 0.0\n\nEND\n"
    )
    return psf, crd, rtf, prm


def gromacs(folder, x, side):
    """Write gro and top of positions (3 n, 3) in a cubic box, in angstrom; return their paths."""
    n = len(x) // 3
    gro, top = folder / "water.gro", folder / "water.top"
    sigma, epsilon = 0.2 * RADIUS / 2 ** (1 / 6), 4.184 * EPSILON
    gro.write_text(
        f"water\n{3 * n:5d}\n"
        + "".join(
            f"{i // 3 + 1:5d}SOL  {NAMES[i % 3]:>5s}{i + 1:5d}{r[0] / 10:8.3f}{r[1] / 10:8.3f}{r[2] / 10:8.3f}\n"
            for i, r in enumerate(x)
        )
        + f"{side / 10:10.5f}{side / 10:10.5f}{side / 10:10.5f}\n"
    )
    atoms = "".join(f"{i + 1} {KINDS[i]} 1 SOL {NAMES[i]} 1 {CHARGES[i]} {MASSES[i]}\n" for i in range(3))
    top.write_text(
        "[ defaults ]\n1 2 yes 0.5 0.8333\n[ atomtypes ]\n"
        f"OW OW 8 {MASSES[0]} 0.0 A {sigma} {epsilon}\nHW HW 1 {MASSES[1]} 0.0 A 1.0 0.0\n"
        f"[ moleculetype ]\nSOL 2\n[ atoms ]\n{atoms}"
        f"[ settles ]\n1 1 {LENGTH / 10} {ACROSS / 10}\n[ exclusions ]\n1 2 3\n2 1 3\n3 1 2\n"
        f"[ system ]\nwater\n[ molecules ]\nSOL {n}\n"
    )
    return gro, top


def _rows(form, values):
    """Return values in lines of a Fortran format with one kind of field."""
    count, rest = int(form[: min(i for i, c in enumerate(form) if c.isalpha())]), form.lstrip("0123456789")
    width, _, digits = rest[1:].partition(".")
    pattern = {"a": f"<{width}s", "I": f"{width}d", "E": f"{width}.{digits}E", "F": f"{width}.{digits}f"}[rest[0]]
    fields = [format(value, pattern) for value in values]
    return "".join("".join(fields[i : i + count]) + "\n" for i in range(0, len(fields), count)) or "\n"
