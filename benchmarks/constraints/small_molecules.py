"""Small rigid molecules, all of whose distances are constrained, and the table of their properties."""

from __future__ import annotations

import itertools

import numpy as np
import openmm

from benchmarks.common.markdown import table
from openmm_exactrb.detection.find import find_bodies


def ring(radius, n=6):
    turns = 2.0 * np.pi / n * np.arange(n)
    return radius * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(n)])


TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5
OCTAHEDRON = np.vstack([np.eye(3), -np.eye(3)])
LABELS = {"CO2": "CO₂", "SF6": "SF₆"}
#: Masses, places in nm, and the principal moments by hand: of methane 8/3 m r², of SF6 4 m r², and so on.
MOLECULES = {
    "methane": ([12.011, *4 * [1.008]], np.vstack([np.zeros(3), 0.109 * TETRAHEDRON]), 3 * [8 / 3 * 1.008 * 0.109**2]),
    "SF6": ([32.06, *6 * [18.998]], np.vstack([np.zeros(3), 0.1561 * OCTAHEDRON]), 3 * [4 * 18.998 * 0.1561**2]),
    "benzene": (
        [*6 * [12.011], *6 * [1.008]],
        np.vstack([ring(0.1391), ring(0.2471)]),
        [k * (12.011 * 0.1391**2 + 1.008 * 0.2471**2) for k in (3, 3, 6)],
    ),
    "CO2": (
        [12.011, 15.999, 15.999],
        0.116 * np.array([[0, 0, 0], [0, 0, 1], [0, 0, -1]]),
        [0, *2 * [2 * 15.999 * 0.116**2]],
    ),
    "formate": (
        [12.011, 15.999, 15.999, 1.008],
        np.array([[0, 0, 0], [0.1125, 0.055, 0], [-0.1125, 0.055, 0], [0, -0.11, 0]]),
        None,
    ),
    "five points": ([1.0, 2.0, 3.0, 4.0, 5.0], 0.3 * np.random.default_rng(1).random((5, 3)), None),
}


def small_molecules() -> str:
    """Return constraints, degrees of freedom and principal moments, as the detection of bodies finds them."""
    body = []
    for name, (masses, x, _) in MOLECULES.items():
        system, pairs = openmm.System(), list(itertools.combinations(range(len(x)), 2))
        for mass in masses:
            system.addParticle(mass)
        for i, j in pairs:
            system.addConstraint(i, j, np.linalg.norm(x[i] - x[j]))
        moments = find_bodies(system, x).kinds[0].inertia[0]
        left = 3 + int(np.count_nonzero(moments > 1e-9))
        numbers = len(pairs), 3 * len(x) - left, left
        if name != "five points":  # of which the places do not matter
            body.append((LABELS.get(name, name), *map(str, numbers), ", ".join(f"{value:.3g}" for value in moments)))
    freedom = ("degrees of freedom removed", "degrees of freedom left")
    return table(("molecule", "constraints", *freedom, "principal moments (amu nm²)"), body)
