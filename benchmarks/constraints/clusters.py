"""Clusters with distance constraints for tests of the free flow: masses in amu, pairs, and positions in nm."""

from __future__ import annotations

import numpy as np

from openmm_exactrb.constraints.clusters import ClusterKind, ClusterState
from openmm_exactrb.mathematics.compensated import exactly

C, N, O, H = 12.011, 14.007, 15.999, 1.008
_TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5


def star(rays, mass=C, length=0.109):
    """Return masses, pairs and places of a star XHn."""
    return (
        [mass] + rays * [H],
        [(0, k + 1) for k in range(rays)],
        np.vstack([np.zeros(3), length * _TETRAHEDRON[:rays]]),
    )


def water():
    """Return a triangle with all of its distances: a rigid body."""
    half, d = np.radians(104.52) / 2, 0.09572
    x = d * np.array([[0, 0, 0], [np.sin(half), np.cos(half), 0], [-np.sin(half), np.cos(half), 0]])
    return [O, H, H], [(0, 1), (0, 2), (1, 2)], x


def chain():
    x = 0.153 * np.array([[0, 0, 0], [1, 0, 0], [1.3, 0.95, 0], [2.2, 1.1, 0.4]])
    return 4 * [C], [(0, 1), (1, 2), (2, 3)], x


def ring():
    """Return the chair of the carbons of cyclohexane, with all of its bonds."""
    angle = np.arange(6) * np.pi / 3
    x = np.column_stack([0.145 * np.cos(angle), 0.145 * np.sin(angle), 0.025 * (-1.0) ** np.arange(6)])
    return 6 * [C], [(k, (k + 1) % 6) for k in range(6)], x


def peptide():
    """All bonds of alanine dipeptide, ACE-ALA-NME, at places with bonds of about the right lengths."""
    elements = "HCHHCONHCHCHHHCONHCHHH"
    bonds = [(1, 0), (1, 2), (1, 3), (1, 4), (4, 5), (4, 6), (6, 7), (6, 8), (8, 9), (8, 10), (10, 11), (10, 12)]
    bonds += [(10, 13), (8, 14), (14, 15), (14, 16), (16, 17), (16, 18), (18, 19), (18, 20), (18, 21)]
    rng = np.random.default_rng(8)
    x = np.zeros((22, 3))
    placed = [1]
    waiting = list(bonds)
    while waiting:  # each atom away from those that are there
        i, j = next(b for b in waiting if (b[0] in placed) != (b[1] in placed))
        waiting.remove((i, j))
        old, new = (i, j) if i in placed else (j, i)
        length = 0.109 if "H" in (elements[i], elements[j]) else 0.143
        directions = rng.standard_normal((400, 3))
        tried = x[old] + length * directions / np.linalg.norm(directions, axis=1, keepdims=True)
        x[new] = tried[np.argmax(np.linalg.norm(tried[:, None] - x[placed], axis=2).min(axis=1))]
        placed.append(new)
    return [{"H": H, "C": C, "N": N, "O": O}[e] for e in elements], bonds, x


CLUSTERS = {
    "water": water(),
    "XH": star(1),
    "XH2": star(2, N, 0.101),
    "XH3": star(3),
    "XH4": star(4, N, 0.101),
    "chain": chain(),
    "ring": ring(),
    "peptide": peptide(),
}


def group_of(masses, pairs, lengths, copies=1):
    """Return clusters of one kind; particle a of cluster i is number i n + a."""
    n = len(masses)
    particles = np.arange(copies * n).reshape(copies, n)
    return ClusterKind(particles, np.array(masses, dtype=float), np.array(pairs), np.array(lengths, dtype=float))


def on_constraints(clusters, x, v):
    """Return the state of clusters from positions and velocities (n_particles, 3) of all particles near it."""
    state = ClusterState(exactly(x[clusters.particles].T), exactly(v[clusters.particles].T * clusters.mass))
    for _ in range(6):  # Newton's steps
        state = clusters.drift(state, 0.0)
    return state


def lengths_of(pairs, x):
    i, j = np.array(pairs).T
    return np.linalg.norm(x[i] - x[j], axis=1)


def velocities(masses, rng, kT=2.494):
    """Return velocities at 300 K in nm/ps, before projection."""
    return rng.standard_normal((len(masses), 3)) * np.sqrt(kT / np.array(masses))[:, None]
