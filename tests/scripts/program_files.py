"""The files in which CHARMM keeps a box of TIP3P; `small_molecules` has those of GROMACS and Amber."""

import numpy as np

# Parameters of TIP3P in angstrom, kcal/mol, e.
CHARGES, MASSES = (-0.834, 0.417, 0.417), (15.999, 1.008, 1.008)
LENGTH, ACROSS, ANGLE = 0.9572, 1.513900654, 104.52
EPSILON, RADIUS = 0.1521, 1.7682927  # of the minimum, between the centres and halved


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
        + f"\n{3 * n:8d} !NBOND: bonds\n{_rows(8, bonds)}\n{n:8d} !NTHETA: angles\n{_rows(9, angles)}"
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


def _rows(count, values):
    """Return numbers in lines of so many fields."""
    fields = [f"{value:8d}" for value in values]
    return "".join("".join(fields[i : i + count]) + "\n" for i in range(0, len(fields), count)) or "\n"
