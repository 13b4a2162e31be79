"""A Stockmayer liquid in Lennard-Jones units: density 0.822, kT = 1.15, mu² = 3, and moments of inertia of 0.2."""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.starts import R, context_of

DENSITY, KT, MU2 = 0.822, 1.15, 3.0
KELVIN = KT / R


def edge_of(n: int) -> float:
    """Return the edge of the box of n dipoles."""
    return (n / DENSITY) ** (1.0 / 3.0)


def fluid(n: int, integrator: openmm.Integrator, boundary: rb.Ewald, **options: Any) -> openmm.Context:
    """Return a Context of the liquid on its lattice."""
    _, system, positions = rb.dipole_fluid(
        n,
        dipole=(0.0, 0.0, MU2**0.5),
        inertia=(0.2, 0.2, 0.2),
        attraction=1.0,
        density=DENSITY,
        boundary=boundary,
        **options,
    )
    return context_of(system, integrator, positions, "Reference")


def arrows(positions: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and unit dipoles, (n, 3) each, of the particles of n spheres: the last two of each."""
    x = positions.reshape(n, -1, 3)[:, -2:]
    return x[:, 0], 2.0 * (x[:, 1] - x[:, 0])


def relative_error(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))
