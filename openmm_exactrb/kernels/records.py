"""Groups of arguments of compiled kernels, as NamedTuples, which numba supports."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Arrays of floats and of integers, with the number of their axes as `build.compiled` reads it.
F1 = Annotated[NDArray[np.float64], "F1"]
#: The same with two axes.
F2 = Annotated[NDArray[np.float64], "F2"]
#: With three axes.
F3 = Annotated[NDArray[np.float64], "F3"]
#: Of integers.
I1 = Annotated[NDArray[np.int64], "I1"]
#: Of integers, with two axes.
I2 = Annotated[NDArray[np.int64], "I2"]


class Graph(NamedTuple):
    """The graph of clusters of n atoms with m constraints, and the e nonzero entries of the Cholesky factor of A."""

    inverse: F1  #: inverse masses of the atoms (n,)
    pairs: I2  #: the two atoms of each constraint (m, 2)
    lengths: F1  #: of the constraints (m,)
    weights: F1  #: B_cd of each entry (e,), row by row, the diagonal last
    rows: I1  #: first entry of each row (m + 1,)
    columns: I1  #: column of each entry (e,)
    starts: I1  #: first of the products that are subtracted from each entry (e + 1,)
    left: I1  #: first entry of each product
    right: I1  #: second entry of each product


class Bodies(NamedTuple):
    """Bodies; those that rotate come first."""

    mass: F1  #: (N,)
    moments: F2  #: of those that turn (3, 1) or (3, K)
    constants: F2  #: of their free rotation, see `openmm_exactrb.rotors.exact.constants`


class Particles(NamedTuple):
    """The particles of bodies, one body after the other."""

    starts: I1  #: the first particle of each body (N + 1,)
    rows: I1  #: of the particles in arrays (n, 3) of all of a System
    sites: F2  #: the place of each particle in its body (n, 3), which counts in those that turn


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
    of_impropers: F2  #: angles, strengths k of k (phi - phi0)², and the circle, as OpenMM's formulas have it (3, .)
    maps: I2  #: particles of two torsions, first patch of a map, and how many it has in each direction (., 10)
    patches: F3  #: coefficients of bicubic polynomials, highest powers first (., 4, 4)
