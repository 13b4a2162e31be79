"""Groups of arguments of compiled kernels, as NamedTuples, which numba supports."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: One-dimensional array of floats, with its code for `build.compiled`.
F1 = Annotated[NDArray[np.float64], "F1"]
#: Two-dimensional array of floats.
F2 = Annotated[NDArray[np.float64], "F2"]
#: Three-dimensional array of floats.
F3 = Annotated[NDArray[np.float64], "F3"]
#: One-dimensional array of integers.
I1 = Annotated[NDArray[np.int64], "I1"]
#: Two-dimensional array of integers.
I2 = Annotated[NDArray[np.int64], "I2"]


class Graph(NamedTuple):
    """The graph of clusters of n atoms with m constraints.

    The Cholesky factor of the matrix A of `plain.clusters` has e nonzero entries.
    """

    inverse: F1  #: inverse masses of the atoms (n,)
    pairs: I2  #: the two atoms of each constraint (m, 2)
    lengths: F1  #: lengths of the constraints (m,)
    weights: F1  #: B_cd of each entry (e,), row by row, the diagonal last
    rows: I1  #: first entry of each row (m + 1,)
    columns: I1  #: column of each entry (e,)
    starts: I1  #: first of the products that are subtracted from each entry (e + 1,)
    left: I1  #: first entry of each product
    right: I1  #: second entry of each product


class Bodies(NamedTuple):
    """Rigid bodies; those that rotate come first."""

    mass: F1  #: (N,)
    moments: F2  #: principal moments of the bodies that rotate, (3, 1) or (3, K)
    constants: F2  #: constants of their free rotation, see `openmm_exactrb.rotors.exact.constants`


class Particles(NamedTuple):
    """The particles of bodies, ordered by body."""

    starts: I1  #: the first particle of each body (N + 1,)
    rows: I1  #: row of each particle in arrays of all particles of a System (n,)
    sites: F2  #: the position of each particle in its body (n, 3), used for bodies that rotate


class Terms(NamedTuple):
    """Bonded terms: the particles of each term, in rows, and its numbers, in columns."""

    bonds: I2
    of_bonds: F2  #: lengths and strengths (2, .)
    angles: I2
    of_angles: F2  #: cosines and sines of angles, and strengths (3, .)
    torsions: I2
    of_torsions: F3  #: coefficients of cosines and sines (2, N, .)
    pairs: I2
    of_pairs: F2  #: products of charges in kJ nm/mol, sigmas and epsilons (3, .)
    impropers: I2
    of_impropers: F2  #: phi0, k of k (phi - phi0)², and the period of phi in OpenMM's formula (3, .)
    maps: I2  #: particles of two torsions, first patch of a map, and its number of patches per direction (., 10)
    patches: F3  #: coefficients of bicubic polynomials, highest powers first (., 4, 4)
